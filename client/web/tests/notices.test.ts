import { expect, it } from "vitest";
import { noticeText } from "../src/jobs/header.js";
import { texts } from "../src/words/words.js";

const { drain, maintenance } = texts.notices;

it.each([
  [null, null, ""],
  ["new disks", null, `${drain} new disks`],
  ["", null, drain],
  // The stronger of two.
  ["new disks", "back at noon", `${maintenance} back at noon`],
])("the notice about a drain (%j) and maintenance (%j) is %j", (drained, maintained, text) => {
  const told = (message: string | null) =>
    message === null ? null : { since: "2026-01-01T00:00:00.000Z", message };
  expect(noticeText({ drain: told(drained), maintenance: told(maintained) })).toBe(text);
});
