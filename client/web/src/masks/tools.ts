/** The tools of the editor: the label, the shape, and the size of the brush. */

import { h } from "../page/dom.js";
import type { Label } from "./corrections.js";
import { fillIn, texts } from "../words/words.js";

export type Shape = "brush" | "box" | "move";
export type Tools = { label: Label; shape: Shape; brush: number };

/** The brush's radius for its setting 1..100, as a share of the photograph's longer side: from 0.1 to 10 %. */
export function brushShare(setting: number): number {
  return 0.001 * 100 ** ((setting - 1) / 99);
}

/** What each key does to the tools. */
export function afterKey(tools: Tools, key: string): Tools | null {
  const brush = (step: number) => ({ ...tools, brush: Math.min(Math.max(tools.brush + step, 1), 100) });
  const changes: Readonly<Record<string, Tools>> = {
    o: { ...tools, label: "object" },
    n: { ...tools, label: "background" },
    b: { ...tools, shape: "brush" },
    x: { ...tools, shape: "box" },
    m: { ...tools, shape: "move" },
    "[": brush(-5),
    "]": brush(5),
  };
  return changes[key] ?? null;
}

/** Return the controls; `changed` is called with every choice of the visitor. */
export function toolControls(initial: Tools, changed: (tools: Tools) => void) {
  let tools = initial;
  const choose = (next: Partial<Tools>) => {
    tools = { ...tools, ...next };
    show();
    changed(tools);
  };
  const choices = <Name extends "label" | "shape">(
    name: Name,
    legend: string,
    options: readonly (readonly [Tools[Name], string, string])[],
  ) => {
    const inputs = options.map(([value, text, key]) => {
      const input = h("input", { type: "radio", name, value, onchange: () => choose({ [name]: value }) });
      return { value, input, label: h("label", { title: fillIn(texts.page.key, { key }) }, input, text) };
    });
    const element = h(
      "fieldset",
      { class: "choices" },
      h("legend", {}, legend),
      ...inputs.map((each) => each.label),
    );
    return { inputs, element };
  };
  const label = choices("label", texts.masks.label, [
    ["background", texts.masks.labels.background, "n"],
    ["object", texts.masks.labels.object, "o"],
  ]);
  const shape = choices("shape", texts.masks.tool, [
    ["brush", texts.masks.tools.brush, "b"],
    ["box", texts.masks.tools.box, "x"],
    ["move", texts.masks.tools.move, "m"],
  ]);
  const brush = h("input", {
    type: "range",
    min: 1,
    max: 100,
    title: texts.masks.brushKeys,
    oninput: () => choose({ brush: Number(brush.value) }),
  });
  const size = h("label", { class: "size" }, texts.masks.brushSize, brush);

  function show(): void {
    for (const each of label.inputs) each.input.checked = each.value === tools.label;
    for (const each of shape.inputs) each.input.checked = each.value === tools.shape;
    brush.value = String(tools.brush);
    size.hidden = tools.shape !== "brush";
  }
  show();
  return {
    element: h("div", { class: "tools" }, label.element, shape.element, size),
    get tools() {
      return tools;
    },
    choose,
  };
}
