// Prints the report of the Khronos glTF validator about a file, as JSON; ends with 1 where it finds errors.
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

const [path] = process.argv.slice(2);
if (path === undefined) {
  console.error("usage: node scripts/validate_gltf.mjs FILE.glb");
  process.exit(2);
}
const report = await validator.validateBytes(new Uint8Array(readFileSync(path)), { maxIssues: 100 });
console.log(JSON.stringify(report, null, 1));
process.exitCode = report.issues.numErrors > 0 ? 1 : 0;
