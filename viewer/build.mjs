// Builds the page's parts into gesticulator/assets: the script, the style sheet, the page and the licences of what is in it.

import { readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.env.VIEWER_OUT ?? join(here, "..", "gesticulator", "assets");
const options = { bundle: true, minify: true, write: false, target: ["es2022"], charset: "utf8", legalComments: "none", absWorkingDir: here };

// Comments of licences are left out of the script: the notices stand, whole, in viewer.licences.txt, which every page shows.
const script = await build({ ...options, entryPoints: ["src/main.js"], format: "esm", metafile: true });
const style = await build({ ...options, entryPoints: ["src/page.css"] });

/** The packages that went into the script, by name. */
const packages = [...new Set(Object.keys(script.metafile.inputs).flatMap((file) => file.match(/node_modules\/((?:@[^/]+\/)?[^/]+)\//)?.[1] ?? []))].sort();
const notices = packages.map((name) => {
  const folder = join(here, "node_modules", name), { version } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  return `${name} ${version}\n\n${readFileSync(join(folder, "LICENSE"), "utf8").trim()}\n`;
});

writeFileSync(join(out, "viewer.min.js.gz"), gzipSync(script.outputFiles[0].contents, { level: 9 }));
writeFileSync(join(out, "viewer.css"), style.outputFiles[0].contents);
writeFileSync(join(out, "viewer.html"), readFileSync(join(here, "src", "page.html")));
writeFileSync(join(out, "viewer.licences.txt"), notices.join("\n\n"));
