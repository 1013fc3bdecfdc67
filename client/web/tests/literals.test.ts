import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { describe, expect, it } from "vitest";
import { literalsIn, textsIn } from "./support/literals.js";

const web = join(import.meta.dirname, "..");

const passed: ReadonlySet<string> = new Set([
  // The same in all languages: names, addresses, units.
  "Lambent",
  "… · Lambent",
  "Glossy Synthetic",
  "NeRF-Blender (transforms_*.json)",
  "POST /v1/login-links",
  "EV",
  "https://shop.example",
  "https://…/map.exr",
  // Only programmers read these: they say that our own code is wrong.
  "a light needs a bundle",
  "a picture without light was asked for",
  "another answer than was asked for",
  "no bundle is open",
  "… is not a power of two",
  "… levels; use 2 to 16",
]);

describe("texts that people read", () => {
  const modules = readdirSync(join(web, "src"), { recursive: true, encoding: "utf8" }).filter(
    (path) => path.endsWith(".ts") && !path.endsWith(".d.ts") && !/^(words|contract)\//.test(path),
  );

  it("are in the catalogues and not in other modules", () => {
    expect(modules.length).toBeGreaterThan(150);
    const found = modules.flatMap((path) =>
      literalsIn(readFileSync(join(web, "src", path), "utf8"), passed).map(
        ({ line, text }) => `src/${path}:${line}: ${JSON.stringify(text)}`,
      ),
    );
    expect(found).toEqual([]);
  });

  it("of the pages themselves are so, too", () => {
    const pages = readdirSync(web).filter((name) => name.endsWith(".html"));
    expect(pages.length).toBe(4);
    for (const name of pages) {
      const texts = textsIn(readFileSync(join(web, name), "utf8"));
      expect({ name, texts: [...new Set(texts)] }).toEqual({ name, texts: ["Lambent"] });
    }
  });

  it.each([
    'element.textContent = "Ready";',
    'h("p", { class: "faint card" }, "live");',
    "make('input', { ariaLabel: `Name of it` });",
    'button("OK", act);',
    'throw new Error("the server does not answer");',
    'const names = { a: "two words" };',
    'element.setAttribute("aria-label", open ? "Shut" : other);',
    'say(count, "in all of them");',
  ])("are found in %s", (source) => {
    expect(literalsIn(source)).toHaveLength(1);
  });

  it.each([
    'import { a } from "./two words.js";',
    'h("div", { class: "card pictured", type: "button" }, texts.page.undo);',
    'root.querySelector("main .card");',
    'if (event.key === "Escape") stop();',
    "const shader = `vec4 lobe = mix(a, b);`;",
    'type Two = "one of" | "two of";',
  ])("are not found in %s", (source) => {
    expect(literalsIn(source)).toEqual([]);
  });

  it("are found in a page", () => {
    expect(textsIn('<title>Lambent</title><p title="Help">%words.needsScript%<b>Open</b></p>')).toEqual([
      ...["Lambent", "Open", "Help"],
    ]);
  });
});
