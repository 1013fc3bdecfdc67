/** The Python packages that tests start programs of, which must be those of this checkout. */

import { execFileSync } from "node:child_process";
import { existsSync, realpathSync } from "node:fs";
import { delimiter, join, resolve, sep } from "node:path";

export const root = resolve(import.meta.dirname, "../../../..");
export const python = process.env.PYTHON ?? join(root, ".venv/bin/python");

/** Folders of the packages, and one package of each. */
const folders = {
  lambent_pages: "client/python",
  lambent_server: "server",
  lambent_run: "worker",
  lambent_proto: "proto",
} as const;

/** Return PYTHONPATH as it is, after folders of this checkout. */
export function pathWith(...names: string[]): string {
  const given = process.env.PYTHONPATH ?? "";
  return [...names.map((name) => join(root, name)), ...(given === "" ? [] : [given])].join(delimiter);
}

/**
 * Return why programs would not be those of the checkout `home`, or null; `found` is where Python finds packages,
 * null for one that it does not find.
 */
export function foreign(found: Readonly<Record<string, string | null>>, home: string): string | null {
  const elsewhere = Object.entries(found).filter(([, place]) => !place?.startsWith(home + sep));
  if (elsewhere.length === 0) return null;
  const places = elsewhere.map(([name, place]) => `${name} ${place === null ? "nowhere" : `in ${place}`}`);
  const wanted = Object.values(folders).map((name) => join(home, name));
  return (
    `Python finds ${places.join(", ")}, and these are the tests of ${home}. ` +
    `Set PYTHONPATH=${wanted.join(delimiter)}`
  );
}

/** Throw where Python would run another checkout's programs, or serve its pages. */
export function requireCheckout(): void {
  const program = `
import importlib.util, json, sys
found = {name: importlib.util.find_spec(name) for name in sys.argv[1:]}
print(json.dumps({name: spec and spec.origin for name, spec in found.items()}))`;
  const printed = execFileSync(python, ["-c", program, ...Object.keys(folders)], { encoding: "utf8" });
  const found = JSON.parse(printed) as Record<string, string | null>;
  const real = Object.entries(found).map(([name, place]) => [name, place && realpathSync(place)] as const);
  const problem = foreign(Object.fromEntries(real), realpathSync(root));
  if (problem !== null) throw new Error(problem);
}

/** Before the tests of pages: they need this checkout's, built. */
export function setup(): void {
  requireCheckout();
  if (!existsSync(join(root, "client/python/lambent_pages/dist/jobs.html"))) {
    throw new Error("the pages are not built; run `npm run build`");
  }
}
