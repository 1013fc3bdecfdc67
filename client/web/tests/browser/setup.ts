/** Builds the viewer's page, lets Python write what it must show, and serves both. */

import { execFileSync } from "node:child_process";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { build } from "vite";
import type { TestProject } from "vitest/node";
import { pathWith, python, requireCheckout, root } from "../support/checkout.js";
import { serveFolders } from "../support/server.js";

declare module "vitest" {
  export interface ProvidedContext {
    site: string;
    fixture: string;
    pages: string;
  }
}

const web = resolve(import.meta.dirname, "../..");

export async function setup(project: TestProject): Promise<() => Promise<void>> {
  requireCheckout();
  const folder = mkdtempSync(join(tmpdir(), "lambent-viewer-"));
  const fixture = process.env.LAMBENT_VIEWER_FIXTURE ?? join(folder, "fixture");
  if (process.env.LAMBENT_VIEWER_FIXTURE === undefined) {
    const script = join(root, "tests/support/viewer_fixture.py");
    const env = { ...process.env, PYTHONPATH: pathWith("tests") };
    execFileSync(python, [script, fixture], { stdio: "inherit", env });
  }
  // Several suites may share one build; the first makes it.
  const pages = process.env.LAMBENT_VIEWER_PAGES ?? join(folder, "pages");
  if (!existsSync(join(pages, "viewer.html"))) {
    await build({ root: web, logLevel: "error", build: { outDir: pages, emptyOutDir: true } });
  }
  const server = await serveFolders({
    "": pages,
    data: fixture,
    pages: join(import.meta.dirname, "pages"),
    // As our server keeps it.
    "v1/bundles/bundle_1/files": join(fixture, "bundle"),
  });
  project.provide("site", server.url);
  project.provide("fixture", fixture);
  project.provide("pages", pages);
  return async () => {
    await server.close();
    rmSync(folder, { recursive: true, force: true });
  };
}
