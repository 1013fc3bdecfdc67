/** Texts of the pages for browsers without scripts, from the catalogues, in every language. */

import type { Plugin } from "vite";
import type { Catalogue } from "../src/words/languages.js";

/** Return a page with the sentences that it names as `%words.KEY%`, a key of `texts.page`. */
export function withWords(html: string, catalogues: Readonly<Record<string, Catalogue>>): string {
  return html.replace(/%words\.(\w+)%/g, (_, key: string) =>
    Object.entries(catalogues)
      .map(([language, { texts }]) => {
        const text = (texts.page as Readonly<Record<string, unknown>>)[key];
        if (typeof text !== "string") throw new Error(`there is no text "page.${key}"`);
        return `<span lang="${language}">${text}</span>`;
      })
      .join(" "),
  );
}

/** Fill these sentences into the pages that are built. */
export function pageWords(catalogues: Readonly<Record<string, Catalogue>>): Plugin {
  return { name: "page-words", transformIndexHtml: (html) => withWords(html, catalogues) };
}
