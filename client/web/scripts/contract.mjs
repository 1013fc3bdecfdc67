// Generates the TypeScript of proto/, of the REST interface, and of the numbers and the reflectance that Python shares, into src/contract, or
// with --check lists the files that differ.
// protoc comes with grpcio-tools in the repository's .venv; set PYTHON to use another interpreter.
import { execFileSync } from "node:child_process";
import {
  existsSync,
  mkdtempSync,
  mkdirSync,
  readFileSync,
  readdirSync,
  rmSync,
  writeFileSync,
} from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, relative, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const web = resolve(dirname(fileURLToPath(import.meta.url)), "..");
const root = resolve(web, "../..");
const proto = join(root, "proto");
const contract = join(web, "src/contract");

// What the browser reads: bundles with what their messages use, and ONNX graphs.
const messages = "lambent_proto/v1";
const read = ["bundle.proto", "onnx.proto", "scene.proto"];

function filesUnder(folder) {
  if (!existsSync(folder)) return [];
  return readdirSync(folder, { recursive: true, withFileTypes: true })
    .filter((entry) => entry.isFile())
    .map((entry) => relative(folder, join(entry.parentPath ?? entry.path, entry.name)))
    .sort();
}

const python = process.env.PYTHON ?? join(root, ".venv/bin/python");

function generate(target) {
  const plugin = join(web, "node_modules/.bin/protoc-gen-es");
  const sources = read.map((name) => `${messages}/${name}`);
  execFileSync(
    python,
    [
      "-m",
      "grpc_tools.protoc",
      `--proto_path=${proto}`,
      `--plugin=protoc-gen-es=${plugin}`,
      `--es_out=${target}`,
      "--es_opt=target=ts,import_extension=js",
      ...sources,
    ],
    { stdio: "inherit" },
  );
}

/** Write the bodies of the REST interface as types; the generator has a lock folder of its own. */
function generateRest(target) {
  const tool = join(web, "tools/openapi");
  const program = join(tool, "node_modules/.bin/openapi-typescript");
  if (!existsSync(program)) {
    execFileSync("npm", ["ci", "--no-audit", "--no-fund"], {
      cwd: tool,
      stdio: ["ignore", "ignore", "inherit"],
    });
  }
  const { openapi, info, components } = JSON.parse(
    readFileSync(join(root, "docs/reference/openapi.json"), "utf8"),
  );
  const bodies = join(target, "bodies.json");
  writeFileSync(
    bodies,
    JSON.stringify({ openapi, info, paths: {}, components: { schemas: components.schemas } }),
  );
  execFileSync(program, [bodies, "-o", join(target, "rest.ts")], { stdio: ["ignore", "ignore", "inherit"] });
  rmSync(bodies);
}

/** Write the numbers and the reflectance that Python and the browser share. */
function generateShared(target) {
  for (const name of ["shared_constants.py", "shared_reflectance.py"]) {
    execFileSync(python, [join(root, "scripts", name), target], { stdio: "inherit" });
  }
}

function main() {
  const check = process.argv.includes("--check");
  const fresh = mkdtempSync(join(tmpdir(), "lambent-contract-"));
  try {
    generate(fresh);
    generateRest(fresh);
    generateShared(fresh);
    const names = filesUnder(fresh);
    const stale = filesUnder(contract).filter((name) => !names.includes(name));
    const differing = names.filter(
      (name) =>
        !existsSync(join(contract, name)) ||
        readFileSync(join(contract, name), "utf8") !== readFileSync(join(fresh, name), "utf8"),
    );
    if (check) {
      for (const name of [...differing, ...stale]) {
        console.error(`differs: client/web/src/contract/${name}; run \`npm run schema\` in client/web`);
      }
      return differing.length + stale.length > 0 ? 1 : 0;
    }
    for (const name of stale) rmSync(join(contract, name));
    for (const name of differing) {
      mkdirSync(dirname(join(contract, name)), { recursive: true });
      writeFileSync(join(contract, name), readFileSync(join(fresh, name)));
    }
    return 0;
  } finally {
    rmSync(fresh, { recursive: true, force: true });
  }
}

process.exitCode = main();
