/** Elements in one expression. */

type Child = Node | string | null | undefined | false;
type Value = string | number | boolean | null | undefined | ((event: never) => void);

/**
 * Return a new element. Attributes that are `false`, `null` or `undefined` are left out, `true` is an empty one,
 * a function is a listener ("onclick"). Text is never parsed as markup.
 */
export function h<Name extends keyof HTMLElementTagNameMap>(
  name: Name,
  attributes: Readonly<Record<string, Value>> = {},
  ...children: readonly Child[]
): HTMLElementTagNameMap[Name] {
  return filled(document.createElement(name), attributes, children);
}

/** Return a new element of a drawing, as `h` does. */
export function svg<Name extends keyof SVGElementTagNameMap>(
  name: Name,
  attributes: Readonly<Record<string, Value>> = {},
  ...children: readonly Child[]
): SVGElementTagNameMap[Name] {
  return filled(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);
}

function filled<T extends Element>(
  element: T,
  attributes: Readonly<Record<string, Value>>,
  children: readonly Child[],
): T {
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(key.slice(2), value as EventListener);
    else if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(key, value === true ? "" : String(value));
    }
  }
  element.append(...children.filter((child): child is Node | string => Boolean(child)));
  return element;
}

/** Return a section under a heading. */
export function section(
  title: string,
  attributes: { id?: string },
  ...children: readonly Child[]
): HTMLElement {
  return h("section", attributes, h("h2", {}, title), ...children);
}

/** Give a list these children, in this order; those that stay in place are not touched and keep the focus. */
export function arrange(list: Element, children: readonly Element[]): void {
  for (const each of [...list.children]) if (!children.includes(each)) each.remove();
  children.forEach((each, place) => {
    if (list.children[place] !== each) list.insertBefore(each, list.children[place] ?? null);
  });
}

/** Set the text of an element if it differs, so that screen readers announce nothing twice. */
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Replace the children of an element unless it has those of this key already. */
export function replaceKeyed(element: HTMLElement, key: string, make: () => readonly Child[]): void {
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  element.replaceChildren(...make().filter((child): child is Node | string => Boolean(child)));
}
