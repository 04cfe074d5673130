// What the Khronos validator says of glTF files: a line of JSON for each, {errors, warnings, messages}.
const fs = require("fs");
const validator = require("gltf-validator");

(async () => {
  for (const file of process.argv.slice(2)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), { uri: file, maxIssues: 100 });
    const { numErrors: errors, numWarnings: warnings, messages } = report.issues;
    console.log(JSON.stringify({ errors, warnings, messages: messages.filter((m) => m.severity < 2) }));
  }
})();
