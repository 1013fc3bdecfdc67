import { expect, it } from "vitest";
import { foreign } from "./support/checkout.js";

const here = "/code/branch";
const own = { lambent_pages: `${here}/client/python/lambent_pages/__init__.py` };

it("packages of this checkout are accepted", () => {
  expect(foreign(own, here)).toBeNull();
});

it.each([
  ["another checkout", "/code/main/server/lambent_server/__init__.py", /lambent_server in \/code\/main/],
  ["a checkout whose name begins alike", `${here}-2/server/lambent_server/__init__.py`, /branch-2/],
  ["nowhere", null, /lambent_server nowhere/],
])("packages of %s are refused, with what to do", (_, place, named) => {
  const problem = foreign({ ...own, lambent_server: place }, here);
  expect(problem).toMatch(named);
  expect(problem).not.toContain("lambent_pages in");
  expect(problem).toContain(`PYTHONPATH=${here}/client/python:${here}/server:${here}/worker:${here}/proto`);
});
