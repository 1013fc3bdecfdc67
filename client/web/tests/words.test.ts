import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { afterEach, describe, expect, it, vi } from "vitest";
import { verdicts } from "../src/jobs/verdicts.js";
import { withWords } from "../scripts/pageWords.js";
import { openSource } from "../src/bundle/source.js";
import { formatAbout, formatList, formatNumber, formatPercent, formatSize } from "../src/page/format.js";
import { misfilled, placesOf } from "./support/messages.js";
import de from "../src/words/de.json";
import en from "../src/words/en.json";
import { fillIn, languageOfPage, locale, named, speak, speakAsBrowser, texts } from "../src/words/words.js";
import { chosen, languageOf, languages } from "../src/words/languages.js";

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
    vi.doMock("../src/words/de.json", () => {
      throw new Error("offline");
    });
    const words = await import("../src/words/words.js");
    await words.speak("de-AT");
    expect([words.texts.panel.light, words.locale]).toEqual(["Light", "en"]);
    vi.doUnmock("../src/words/de.json");
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
    const what = "studio{n}$1.hdr";
    expect(fillIn(en.texts.link.lacks, { n: 1, what })).toContain(what);
  });

  it("have the form of their language", async () => {
    const told = () => [0, 1, 2, 12345].map((n) => fillIn(texts.page.files, { n }));
    expect(told()).toEqual(["0 files", "1 file", "2 files", "12,345 files"]);
    await speak("de-AT");
    expect(told()).toEqual(["0 Dateien", "1 Datei", "2 Dateien", "12.345 Dateien"]);
  });

  it("have more than two forms where a language has", async () => {
    vi.resetModules();
    vi.doMock("../src/words/languages.js", () => ({ language: "pl", spoken: () => ({}) }));
    const polish = (await import("../src/words/words.js")).fillIn;
    vi.doUnmock("../src/words/languages.js");
    const forms = { one: "{n} plik", few: "{n} pliki", many: "{n} plików", other: "{n} pliku" };
    const told = [1, 2, 5, 22].map((n) => polish(forms, { n }));
    expect(told).toEqual(["1 plik", "2 pliki", "5 plików", "22 pliki"]);
    expect(polish({ other: "{n} rzeczy" }, { n: 5 })).toBe("5 rzeczy");
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
  const leaves = (value: object, path = ""): [path: string, text: string][] =>
    Object.entries(value).flatMap(([key, each]) =>
      typeof each === "string" ? [[`${path}.${key}`, each]] : leaves(each, `${path}.${key}`),
    );

  it("say everything, with places for the same values", () => {
    const [english, german] = [leaves(en), new Map(leaves(de))];
    expect(english.length).toBeGreaterThan(450);
    for (const [path, text] of english) {
      const other = german.get(path) ?? "";
      expect([path, other.trim()]).not.toEqual([path, ""]);
      expect([path, placesOf(other)]).toEqual([path, placesOf(text)]);
    }
    expect(german.size).toBe(english.length);
  });

  it("get the values that their messages have places for", () => {
    const src = join(import.meta.dirname, "../src");
    const modules = readdirSync(src, { recursive: true, encoding: "utf8" }).filter(
      (path) => path.endsWith(".ts") && !path.startsWith("words/"),
    );
    const wrong = modules.flatMap((path) =>
      misfilled(readFileSync(join(src, path), "utf8")).map((each) => `${path}: ${each}`),
    );
    expect(wrong).toEqual([]);
  });

  it.each([
    "say(texts.page.deleted);",
    "say(fillIn(texts.page.deleted, { who: name }));",
    "say(fillIn(texts.page.notDeleted, { what }));",
    "say(fillIn(texts.page.undo, { what }));",
    "say(fillIn(texts.page.files, { number }));",
    "say(fillIn(texts.page.of, { part, whole: texts.page.deleted }));",
    "const { deleted } = texts.page;",
  ])("do not get them in %s", (source) => {
    expect(misfilled(source)).toHaveLength(1);
  });

  it.each([
    "say(fillIn(texts.page.notDeleted, { what, why: texts.page.undo }));",
    "say(fillIn(many ? texts.page.files : texts.upload.known, { n: 5 }));",
    "say(fillIn(texts.verdicts.pictures[name], { truth }));",
    "say(named(texts.states, name));",
  ])("get them in %s", (source) => {
    expect(misfilled(source)).toEqual([]);
  });

  it("fill pages for browsers without scripts", () => {
    expect(withWords("<p>%words.needsScript%</p>", { en, de })).toBe(
      '<p><span lang="en">This page needs JavaScript.</span> ' +
        '<span lang="de">Diese Seite braucht JavaScript.</span></p>',
    );
    expect(() => withWords("%words.other%", { en })).toThrow("page.other");
  });
});
