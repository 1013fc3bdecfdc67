import { describe, expect, it } from "vitest";
import { codeIn, failedSignIn } from "../src/jobs/lockedView.js";
import { texts } from "../src/words/words.js";

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

describe("a sign-in that has failed", () => {
  it.each([
    ["#sign-in=sign_in_refused", texts.locked.signInRefused],
    ["#sign-in=sign_in_failed", texts.locked.signInFailed],
    ["#sign-in=x", texts.locked.signInFailed],
    ["#/jobs/x", null],
    ["", null],
  ])("%j says what to do", (hash, text) => {
    expect(failedSignIn(hash)).toBe(text);
  });
});
