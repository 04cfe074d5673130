// Builds the script of `gesticulator live` into gesticulator/assets/live, and the licences of what is in it.

import { readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.env.LIVE_OUT ?? join(here, "..", "gesticulator", "assets", "live");
// Comments of licences are left out of the script: the notices stand, whole, in licences.txt, which the page links to.
const script = await build({
  entryPoints: ["src/talk/main.js"], bundle: true, minify: true, write: false, format: "esm", metafile: true, target: ["es2022"], charset: "utf8",
  legalComments: "none", absWorkingDir: here,
});
const packages = [...new Set(Object.keys(script.metafile.inputs).flatMap((file) => file.match(/node_modules\/((?:@[^/]+\/)?[^/]+)\//)?.[1] ?? []))].sort();
const notices = packages.map((name) => {
  const folder = join(here, "node_modules", name), { version } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  return `${name} ${version}\n\n${readFileSync(join(folder, "LICENSE"), "utf8").trim()}\n`;
});
writeFileSync(join(out, "live.min.js.gz"), gzipSync(script.outputFiles[0].contents, { level: 9 }));
writeFileSync(join(out, "licences.txt"), notices.join("\n\n"));
