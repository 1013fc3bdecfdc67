import { describe, expect, it } from "vitest";
import { codeIn } from "../src/jobs/lockedView.js";

describe("a one-time link", () => {
  it.each([
    ["http://127.0.0.1:8080/#code=abcDEF_-123", "abcDEF_-123"],
    ["  #code=abcdefgh&x=1 \n", "abcdefgh"],
    ["abcdefgh", "abcdefgh"],
    ["", null],
    ["http://127.0.0.1:8080/", null],
    ["code=short", null],
    [`code=${"a".repeat(201)}`, null],
  ])("%j has the code %j", (text, code) => {
    expect(codeIn(text)).toBe(code);
  });
});
