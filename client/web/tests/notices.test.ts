import { describe, expect, it } from "vitest";
import { noticeText } from "../src/jobs/header.js";
import { texts } from "../src/words/words.js";

const told = (message: string) => ({ since: "2026-01-01T00:00:00.000Z", message });

describe("noticeText", () => {
  it("says nothing where operators have told nothing", () => {
    expect(noticeText({ drain: null, maintenance: null })).toBe("");
  });

  it("says what holds, with the words of the operators", () => {
    expect(noticeText({ drain: told("new disks"), maintenance: null })).toBe(
      `${texts.notices.drain} new disks`,
    );
    expect(noticeText({ drain: told(""), maintenance: null })).toBe(texts.notices.drain);
  });

  it("says the stronger of two", () => {
    const both = { drain: told("new disks"), maintenance: told("back at noon") };
    expect(noticeText(both)).toBe(`${texts.notices.maintenance} back at noon`);
  });
});
