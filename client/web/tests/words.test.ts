import { afterEach, describe, expect, it, vi } from "vitest";
import { verdicts } from "../src/jobs/verdicts.js";
import { withWords } from "../scripts/pageWords.js";
import { openSource } from "../src/bundle/source.js";
import { formatAbout, formatList, formatNumber, formatPercent, formatSize } from "../src/page/format.js";
import { counted } from "../src/words/counted.js";
import * as de from "../src/words/de.js";
import * as en from "../src/words/en.js";
import { chosen, languageOf, languages } from "../src/words/languages.js";
import { languageOfPage, locale, named, speak, speakAsBrowser, texts } from "../src/words/words.js";

afterEach(async () => {
  vi.unstubAllGlobals();
  await speak("en");
});

describe("the language", () => {
  it("is the first wanted one that is shipped, with its region, else English", () => {
    expect(languages).toEqual(["en", "de"]);
    expect(chosen(["fr-CH", "de-CH", "en"])).toBe("de-CH");
    expect(chosen(["EN-gb", "de"])).toBe("en-GB");
    expect(chosen(["fr", "deu"])).toBe("de");
    // What a page says of itself may be no tag.
    expect(chosen(["german!", " de-CH ", ""])).toBe("de-CH");
    expect(chosen(["", "x"])).toBe("en");
    expect(chosen([])).toBe("en");
    expect(languageOf("de-AT")).toBe("de");
  });

  it("of our pages is the browser's", async () => {
    const documentElement = { lang: "en" };
    vi.stubGlobal("document", { documentElement });
    vi.stubGlobal("navigator", { languages: ["fr", "de-AT", "en"] });
    await speakAsBrowser();
    expect([documentElement.lang, locale, texts.panel.light]).toEqual(["de-AT", "de-AT", "Licht"]);
  });

  it.each([
    ["de", "Licht"],
    ["en-GB", "Light"],
    ["fr", "Light"],
    [null, "Light"],
  ])("of an element where the language is %s", async (lang, said) => {
    await speak("de");
    const place = lang === null ? null : { getAttribute: () => lang };
    vi.stubGlobal("document", { querySelector: () => ({ closest: () => place }), documentElement: {} });
    await speak(languageOfPage("lambent-viewer"));
    expect(texts.panel.light).toBe(said);
  });

  it("is English where the other catalogue cannot be fetched, with numbers to go with it", async () => {
    vi.resetModules();
    vi.doMock("../src/words/de.js", () => {
      throw new Error("offline");
    });
    const words = await import("../src/words/words.js");
    await words.speak("de-AT");
    expect([words.texts.panel.light, words.locale]).toEqual(["Light", "en"]);
    vi.doUnmock("../src/words/de.js");
    vi.resetModules();
  });

  it("is that of faults, too", async () => {
    const nothing = { kind: "files", files: new Map() } as const;
    await expect(openSource(nothing)).rejects.toThrow("there is no manifest.json; drop the folder");
    await speak("de");
    await expect(openSource(nothing)).rejects.toThrow("manifest.json fehlt; den Ordner ablegen");
  });
});

describe("counts", () => {
  it("leave what a name has in it as it is", () => {
    expect(en.texts.link.lacks(1, "studio#2.hdr")).toContain("studio#2.hdr");
  });

  it("have the form of their language", () => {
    expect([0, 1, 2, 12345].map(en.texts.page.files)).toEqual([
      ...["0 files", "1 file", "2 files", "12,345 files"],
    ]);
    expect([0, 1, 2, 12345].map(de.texts.page.files)).toEqual([
      ...["0 Dateien", "1 Datei", "2 Dateien", "12.345 Dateien"],
    ]);
  });

  it("have more than two forms where a language has", () => {
    const forms = { one: "{n} plik", few: "{n} pliki", many: "{n} plików", other: "{n} pliku" };
    expect([1, 2, 5, 22].map((count) => counted("pl", count, forms))).toEqual([
      ...["1 plik", "2 pliki", "5 plików", "22 pliki"],
    ]);
    expect(counted("pl", 5, { other: "{n} rzeczy" })).toBe("5 rzeczy");
  });
});

describe("numbers", () => {
  it("are written as in the language", async () => {
    const told = () => [
      formatNumber(1234.5, 1),
      formatPercent(0.876),
      formatSize(1536),
      formatAbout(9000),
      formatList(["a", "b"]),
    ];
    expect(told()).toEqual(["1,234.5", "88%", "1.5 KiB", "2.5 hours", "a and b"]);
    await speak("de");
    expect(told()).toEqual(["1.234,5", "88\u00a0%", "1,5 KiB", "2,5 Stunden", "a und b"]);
    const [verdict] = verdicts({ metrics: [{ name: "nvs/psnr", value: 27.31, unit: "dB" }] });
    expect(verdict).toEqual({
      about: "Neue Ansichten",
      figure: "27,3 dB",
      words: "sehr nah an den Fotos",
    });
  });
});

describe("a code", () => {
  it("is named, or stands for itself", () => {
    expect(named(texts.states, "queued")).toBe("waiting");
    expect(named(texts.states, "odd")).toBe("odd");
    expect(named(texts.states, "toString")).toBe("toString");
  });
});

describe("catalogues", () => {
  type Leaf = { readonly path: string; readonly value: unknown };
  const leaves = (value: unknown, path = ""): Leaf[] =>
    typeof value === "object" && value !== null
      ? Object.entries(value).flatMap(([key, each]) => leaves(each, `${path}.${key}`))
      : [{ path, value }];
  /** What a text says; functions are given numbers that can be told apart. */
  const said = ({ value }: Leaf): string => {
    if (typeof value !== "function") return String(value);
    const given = Array.from({ length: value.length }, (_, index) => 101 + index);
    return [(value as (...values: unknown[]) => unknown)(...given)].flat().join("; ");
  };

  it("say everything, with all that is given to them", () => {
    const english = leaves(en);
    expect(english.length).toBeGreaterThan(450);
    const german = new Map(leaves(de).map((leaf) => [leaf.path, leaf]));
    for (const leaf of english) {
      const other = german.get(leaf.path);
      expect(other, leaf.path).toBeDefined();
      const numbers = (text: string) => text.match(/10\d/g)?.sort();
      expect([leaf.path, numbers(said(other!))]).toEqual([leaf.path, numbers(said(leaf))]);
      expect([leaf.path, said(other!).trim()]).not.toEqual([leaf.path, ""]);
    }
    expect(german.size).toBe(english.length);
  });

  it("fill pages for browsers without scripts", () => {
    expect(withWords("<p>%words.needsScript%</p>", { en, de })).toBe(
      '<p><span lang="en">This page needs JavaScript.</span> ' +
        '<span lang="de">Diese Seite braucht JavaScript.</span></p>',
    );
    expect(() => withWords("%words.other%", { en })).toThrow("page.other");
  });
});
