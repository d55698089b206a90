// Khronos glTF validator over GLBs: 0 errors, and no warning whose code the input does not have as well.
// node validate.mjs OUTPUT.glb[=INPUT.glb] …
import { readFileSync } from 'node:fs';
import validator from 'gltf-validator';

const SEVERITY_ERROR = 0;
const SEVERITY_WARNING = 1;

async function issues(path) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(path)), { maxIssues: 0 });
  return report.issues.messages.filter((m) => m.severity <= SEVERITY_WARNING);
}

let bad = 0;
for (const argument of process.argv.slice(2)) {
  const [output, input] = argument.split('=');
  const known = input?.endsWith('.glb') ? new Set((await issues(input)).map((m) => m.code)) : new Set();
  const found = (await issues(output)).filter((m) => m.severity === SEVERITY_ERROR || !known.has(m.code));
  if (found.length > 0) {
    bad += 1;
    console.log(`${output}: ${found.length} issues, the first: ${found[0].code} ${found[0].message} at ${found[0].pointer}`);
  }
}
console.log(`gltf-validator: ${process.argv.length - 2 - bad} of ${process.argv.length - 2} files without new errors or warnings`);
process.exit(bad > 0 ? 1 : 0);
