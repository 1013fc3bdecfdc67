/** Plain form fields with labels. */

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

/** Definition of a slider. */
export type SliderSpec = {
  readonly label: string;
  readonly range: readonly [number, number];
  readonly step: number;
  readonly unit?: string;
  readonly change: (value: number) => void;
};

/** A slider with a number field. */
export function slider({ label, range, step, unit = "", change }: SliderSpec): Field<number> {
  const [min, max] = [String(range[0]), String(range[1])];
  const name = unit === "" ? label : `${label} (${unit})`;
  const track = make("input", { type: "range", min, max, step: String(step), ariaLabel: name });
  const entry = make("input", {
    type: "number",
    min,
    max,
    step: String(step),
    ariaLabel: `${name}, as a number`,
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

/** A list to choose from. */
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

/** A box to tick. */
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

/** A button. */
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
