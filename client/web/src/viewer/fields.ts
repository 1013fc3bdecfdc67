/** Plain form fields with labels. */

import { fillIn, texts } from "../words/words.js";

/** A field that shows a value and reports changes by the user. */
export type Field<T> = { readonly element: HTMLElement; readonly show: (value: T) => void };

/** Make an element with text or children. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Partial<HTMLElementTagNameMap[K]> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** Return a function that adds listeners to elements until `signal`. */
export function listening(signal: AbortSignal) {
  return <K extends keyof HTMLElementEventMap>(
    element: HTMLElement,
    name: K,
    hear: (event: HTMLElementEventMap[K]) => void,
  ): void => element.addEventListener(name, hear, { signal });
}

/** Events that end a drag: the last one also where something else took the pointer away, as a dialog does. */
export const releases = ["pointerup", "pointercancel", "lostpointercapture"] as const;

/** A slider with a number field. */
export function slider(
  label: string,
  range: readonly [number, number],
  step: number,
  change: (value: number) => void,
  unit = "",
): Field<number> {
  const limits = { min: String(range[0]), max: String(range[1]), step: String(step) };
  const name = unit === "" ? label : `${label} (${unit})`;
  const track = make("input", { type: "range", ...limits, ariaLabel: name });
  const entry = make("input", {
    type: "number",
    ...limits,
    ariaLabel: fillIn(texts.viewer.asNumber, { name }),
  });
  const changed = (source: HTMLInputElement) => () => {
    const value = source.valueAsNumber;
    if (!Number.isFinite(value)) return;
    const other = source === track ? entry : track;
    other.value = source.value;
    change(Math.min(Math.max(value, range[0]), range[1]));
  };
  track.addEventListener("input", changed(track));
  entry.addEventListener("change", changed(entry));
  const row = make("div", { className: "row" }, make("span", { ariaHidden: "true" }, name));
  row.append(make("div", { className: "slide" }, track, entry));
  return {
    element: row,
    show: (value) => {
      track.value = String(value);
      const text = String(Number(value.toFixed(3)));
      if (entry.value !== text) entry.value = text;
    },
  };
}

export function choice<T extends string>(
  label: string,
  options: () => readonly (readonly [value: T, text: string])[],
  change: (value: T) => void,
): Field<T> & { readonly refill: () => void } {
  const list = make("select");
  const refill = (): void => {
    const kept = list.value;
    list.replaceChildren(...options().map(([value, text]) => make("option", { value, textContent: text })));
    list.value = kept;
  };
  refill();
  list.addEventListener("change", () => change(list.value as T));
  return {
    element: make("label", {}, label, list),
    show: (value) => {
      list.value = value;
    },
    refill,
  };
}

export function check(label: string, change: (on: boolean) => void): Field<boolean> {
  const box = make("input", { type: "checkbox" });
  box.addEventListener("change", () => change(box.checked));
  return {
    element: make("label", { className: "check" }, box, label),
    show: (on) => {
      box.checked = on;
    },
  };
}

export function button(text: string, press: () => void): HTMLButtonElement {
  const element = make("button", { type: "button", textContent: text });
  element.addEventListener("click", press);
  return element;
}

/** A part of the panel that opens and closes. */
export function section(title: string, open: boolean, ...children: Node[]): HTMLDetailsElement {
  const body = make("div", { className: "fields" }, ...children);
  return make("details", { open }, make("summary", { textContent: title }), body);
}
