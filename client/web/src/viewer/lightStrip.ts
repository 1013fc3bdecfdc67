/** The lights that can be chosen, as a row of buttons with pictures of them. */

import { button, make } from "./fields.js";
import { lightTexts } from "./lightTexts.js";
import type { Viewer } from "./viewer.js";
import { texts } from "../words/words.js";

export type StripActions = {
  readonly choose: (light: string) => void;
  readonly openMap: () => void;
  readonly openAddress: (address: string) => void;
};

/** Side of a picture in pixels; it is shown at half of that. */
const side = 96;

type Chip = { readonly element: HTMLButtonElement; readonly picture: HTMLCanvasElement; key: string };

/** Build the row; `show` follows the viewer's state, and `element` closes with `signal`. */
export function lightStrip(viewer: Viewer, act: StripActions, signal: AbortSignal) {
  const chips = new Map<string, Chip>();
  const add = make("button", { type: "button", className: "chip add", ariaExpanded: "false" });
  add.append(make("span", { className: "plus", textContent: "+", ariaHidden: "true" }), texts.light.add);
  const row = make("div", { className: "chips", role: "toolbar", ariaLabel: texts.light.strip });
  const adding = addForm(act, () => open(false));
  const line = make("div", { className: "line" }, row);
  const element = make("div", { className: "strip" }, adding, line);

  function open(on: boolean): void {
    adding.hidden = !on;
    add.ariaExpanded = String(on);
    if (on) adding.querySelector("button")?.focus();
    else if (element.contains(deepFocus(element))) add.focus();
  }
  add.addEventListener("click", () => open(adding.hidden === true));
  adding.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    event.stopPropagation();
    open(false);
  });
  hearKeys(row);

  let listed = "";
  let lights: readonly string[] = [];
  const show = (): void => {
    const named = lightTexts(viewer);
    const key = JSON.stringify(named);
    if (key !== listed) {
      listed = key;
      lights = named.map(([light]) => light);
      row.replaceChildren(...chipsFor(named, chips, act.choose), add);
    }
    press(row, chips, viewer.state.environment);
  };
  const paint = painter(viewer, chips, () => lights, signal);
  // The picture that someone waits for comes first.
  const stop = viewer.on("draw", () => void paint());
  signal.addEventListener("abort", stop);
  return { element, row: line, show };
}

/** Move the focus along the row by arrows: one button of it is reached by Tab, the others from it. */
function hearKeys(row: HTMLElement): void {
  row.addEventListener("keydown", (event) => {
    const all = [...row.querySelectorAll("button")];
    const at = all.indexOf(event.target as HTMLButtonElement);
    const next = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: all.length - 1 }[event.key];
    if (next === undefined || at < 0) return;
    event.preventDefault();
    all.at(next % all.length)!.focus();
  });
  row.addEventListener("focusin", (event) => {
    for (const each of row.querySelectorAll("button")) each.tabIndex = each === event.target ? 0 : -1;
  });
}

/** Return the buttons of lights, with their names; those that are gone are forgotten. */
function chipsFor(
  named: readonly (readonly [light: string, text: string])[],
  chips: Map<string, Chip>,
  choose: (light: string) => void,
): HTMLButtonElement[] {
  const lights = new Set(named.map(([light]) => light));
  for (const light of [...chips.keys()]) if (!lights.has(light)) chips.delete(light);
  return named.map(([light, text]) => {
    let chip = chips.get(light);
    if (chip === undefined) {
      const picture = make("canvas", { width: side, height: side, ariaHidden: "true" });
      const element = make("button", { type: "button", className: "chip" }, picture, make("span"));
      element.addEventListener("click", () => choose(light));
      chip = { element, picture, key: "" };
      chips.set(light, chip);
    }
    chip.element.querySelector("span")!.textContent = text;
    chip.element.title = text;
    return chip.element;
  });
}

/** Mark the light that is shown; the row follows it unless someone is on the row. */
function press(row: HTMLElement, chips: ReadonlyMap<string, Chip>, environment: string): void {
  for (const [light, { element }] of chips) {
    const pressed = light === environment;
    if (element.ariaPressed === String(pressed)) continue;
    element.ariaPressed = String(pressed);
    if (pressed && !row.contains(deepFocus(row))) {
      for (const each of row.querySelectorAll("button")) each.tabIndex = each === element ? 0 : -1;
      scrollTo(row, element);
    }
  }
}

/** Return what makes missing pictures, one after another, so that a chosen light waits for one of them at most. */
function painter(
  viewer: Viewer,
  chips: ReadonlyMap<string, Chip>,
  lights: () => readonly string[],
  signal: AbortSignal,
): () => Promise<void> {
  let working = false;
  return async () => {
    if (working) return;
    working = true;
    const keyOf = (light: string): string => {
      const of = light.startsWith("trained:") ? viewer.bundle?.sceneId : viewer.lights.version(light);
      return `${light} ${of}`;
    };
    try {
      for (;;) {
        const light = lights().find((each) => chips.get(each)?.key !== keyOf(each));
        const chip = light === undefined ? undefined : chips.get(light);
        if (light === undefined || chip === undefined) return;
        if (signal.aborted || viewer.bundle === null) return;
        chip.key = keyOf(light);
        const pixels = await viewer.lights.thumbnail(light, side).catch(() => null);
        // A map that cannot be used says so when it is chosen.
        if (pixels === null) chip.picture.getContext("2d")?.clearRect(0, 0, side, side);
        else chip.picture.getContext("2d")?.putImageData(new ImageData(pixels, side, side), 0, 0);
      }
    } finally {
      working = false;
    }
  };
}

function addForm(act: StripActions, done: () => void): HTMLElement {
  const address = make("input", { type: "url", placeholder: "https://…/map.exr" });
  const use = (): void => {
    if (address.value === "") return;
    act.openAddress(address.value);
    address.value = "";
    done();
  };
  address.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    // The button that gets the focus is not pressed by the same key.
    event.preventDefault();
    use();
  });
  const file = button(texts.light.openMap, () => {
    done();
    act.openMap();
  });
  const form = make(
    "div",
    { className: "adding", hidden: true, role: "group", ariaLabel: texts.light.add },
    file,
    make("label", {}, texts.light.fromAddress, address),
    button(texts.light.useAddress, use),
  );
  return form;
}

/** Return what has the focus in the tree that an element is in, or null. */
function deepFocus(element: HTMLElement): Element | null {
  const root = element.getRootNode();
  return root instanceof ShadowRoot || root instanceof Document ? root.activeElement : null;
}

/** Bring a button of the row into it; never scrolls the page. */
function scrollTo(row: HTMLElement, chip: HTMLElement): void {
  const [from, to] = [chip.offsetLeft - row.offsetLeft, chip.offsetLeft - row.offsetLeft + chip.offsetWidth];
  if (from < row.scrollLeft) row.scrollLeft = from - 16;
  else if (to > row.scrollLeft + row.clientWidth) row.scrollLeft = to - row.clientWidth + 16;
}
