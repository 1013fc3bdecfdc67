/** English on pages that speak another language. */

import type { Page } from "playwright-core";
import de from "../../src/words/de.json";
import en from "../../src/words/en.json";

function sentences(value: unknown): string[] {
  if (typeof value === "string") return [value.trim()];
  return typeof value === "object" && value !== null ? Object.values(value).flatMap(sentences) : [];
}

/** Return what a page says, in its texts and to those who do not see it, shadow roots and hidden parts included. */
export function saidOn(page: Page): Promise<string[]> {
  return page.evaluate(() => {
    const found = new Set<string>();
    const look = (root: Document | ShadowRoot): void => {
      const walker = document.createTreeWalker(root, NodeFilter.SHOW_ELEMENT | NodeFilter.SHOW_TEXT);
      for (let node = walker.nextNode(); node !== null; node = walker.nextNode()) {
        if (node instanceof Element) {
          for (const name of ["aria-label", "title", "placeholder", "alt", "aria-valuetext"]) {
            found.add(node.getAttribute(name)?.trim() ?? "");
          }
          if (node.shadowRoot !== null) look(node.shadowRoot);
        } else if (!node.parentElement?.closest("script, style, noscript")) {
          found.add(node.textContent?.trim() ?? "");
        }
      }
    };
    look(document);
    found.delete("");
    return [...found];
  });
}

/** Return the English texts of a German page; what is the same in both languages is none. */
export async function englishOn(page: Page): Promise<string[]> {
  const german = new Set(sentences(de));
  const english = new Set(sentences(en).filter((text) => !german.has(text)));
  return (await saidOn(page)).filter((text) => english.has(text));
}

/** Return what does not fit into its place, below `selector`: its class or tag, and how wide it is and may be. */
export function overflowing(page: Page, selector: string): Promise<string[]> {
  return page.evaluate((wanted) => {
    const roots = [document, ...[...document.querySelectorAll("*")].map((each) => each.shadowRoot)];
    const places = roots.flatMap((root) => [...(root?.querySelectorAll(wanted) ?? [])]);
    if (places.length === 0) throw new Error(`there is no ${wanted}`);
    // A text beside a control may need more than its place, and lie under the control then.
    const covered = (label: Element): string[] => {
      const [first, control] = [label.firstChild, label.firstElementChild];
      if (!(first instanceof Text) || control === null) return [];
      const range = document.createRange();
      range.selectNode(first);
      const [text, box] = [range.getBoundingClientRect(), control.getBoundingClientRect()];
      const isBeside = text.bottom > box.top && text.top < box.bottom && box.width > 0;
      return isBeside && text.right > box.left ? [`LABEL ${first.textContent}`] : [];
    };
    const labels = places.flatMap((place) => [...place.querySelectorAll("label")].flatMap(covered));
    const wide = places
      .flatMap((place) => [place, ...place.querySelectorAll("*")])
      .filter(
        (each) => each instanceof HTMLElement && each.clientWidth > 0 && !each.matches("input, pre, .sr"),
      )
      .filter(({ scrollWidth, clientWidth }) => scrollWidth > clientWidth)
      .map((each) => `${each.tagName} ${each.className}: ${each.scrollWidth} in ${each.clientWidth} pixels`);
    const context = new OffscreenCanvas(1, 1).getContext("2d")!;
    const cut = (input: HTMLInputElement): string[] => {
      const { font, paddingLeft, paddingRight } = getComputedStyle(input);
      context.font = font;
      const needed = context.measureText(input.placeholder).width;
      const room = input.clientWidth - Number.parseFloat(paddingLeft) - Number.parseFloat(paddingRight);
      return needed > room ? [`"${input.placeholder}": ${Math.ceil(needed)} in ${room} pixels`] : [];
    };
    const placeholders = places
      .flatMap((place) => [...place.querySelectorAll<HTMLInputElement>("input[placeholder]")])
      .filter(({ clientWidth }) => clientWidth > 0)
      .flatMap(cut);
    return [...labels, ...wide, ...placeholders];
  }, selector);
}
