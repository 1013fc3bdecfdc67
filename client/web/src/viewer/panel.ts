/** The controls next to the picture. */

import type { BackgroundKind, Channel, LightTurn, Look, MaterialEdit, ToneCurve } from "../render/looks.js";
import { button, check, choice, type Field, make, section, slider } from "./fields.js";
import { lightTexts } from "./lightTexts.js";
import type { ResetPart } from "./resets.js";
import { sharing } from "./sharing.js";
import { type Comparison, initialState, limits, type ViewerState } from "./state.js";
import type { Viewer } from "./viewer.js";
import { statusText } from "../refine/status.js";

/** Actions of the panel other than changes of state. */
export type PanelActions = {
  readonly change: (change: Partial<ViewerState>) => void;
  readonly openBundle: () => void;
  readonly openFolder: () => void;
  readonly reset: (part: ResetPart) => void;
  readonly savePng: (width: number, height: number) => void;
  readonly saveExr: (width: number, height: number) => void;
  readonly film: () => void;
  readonly copyLink: () => void;
};

const channelTexts: readonly (readonly [Channel, string])[] = [
  ["final", "Final picture"],
  ["direct", "Direct light"],
  ["indirect", "Indirect light"],
  ["visibility", "Visibility of the sky"],
  ["albedo", "Albedo"],
  ["roughness", "Perceptual roughness"],
  ["metalness", "Metalness"],
  ["normal", "Normals"],
  ["depth", "Depth"],
  ["uncertainty", "Uncertainty of albedo"],
];
const toneTexts: readonly (readonly [ToneCurve, string])[] = [
  ["neutral", "Neutral"],
  ["agx", "AgX"],
  ["aces", "ACES"],
  ["linear", "Linear (clipped)"],
];
const backgroundTexts: readonly (readonly [BackgroundKind, string])[] = [
  ["environment", "Environment"],
  ["blurred", "Environment, blurred"],
  ["colour", "Colour"],
  ["transparent", "Transparent"],
];

/** Build the panel; the result follows the viewer's state. */
export function buildPanel(
  viewer: Viewer,
  act: PanelActions,
): { element: HTMLDetailsElement; show: () => void } {
  const shown: (() => void)[] = [];
  const follow = <T>(field: Field<T>, value: (state: ViewerState) => T): HTMLElement => {
    shown.push(() => field.show(value(viewer.state)));
    return field.element;
  };
  const look = (part: Partial<Look>): void => act.change({ look: { ...viewer.state.look, ...part } });
  const edit = (part: Partial<MaterialEdit>): void => look({ edit: { ...viewer.state.look.edit, ...part } });
  const turn = (part: Partial<LightTurn>): void => act.change({ turn: { ...viewer.state.turn, ...part } });

  /** Return what makes fields of a part of the state, by their name in it. */
  const fieldsOf =
    <T>(part: (state: ViewerState) => T, change: (part: Partial<T>) => void) =>
    <K extends keyof T>(name: K, field: (change: (value: T[K]) => void) => Field<T[K]>): HTMLElement => {
      const made = field((value) => change({ [name]: value } as unknown as Partial<T>));
      return follow(made, (state) => part(state)[name]);
    };
  const ofState = fieldsOf((state) => state, act.change);
  const ofLook = fieldsOf((state) => state.look, look);
  const ofEdit = fieldsOf((state) => state.look.edit, edit);
  const ofTurn = fieldsOf((state) => state.turn, turn);

  const environments = () => lightTexts(viewer);
  const lightsB = choice("On the right", environments, (environmentB) => act.change({ environmentB }));
  const angle = (label: string, part: "yawDeg" | "pitchDeg" | "rollDeg"): HTMLElement =>
    ofTurn(part, (change) => slider(label, limits.angle, 1, change, "°"));
  const photos = choice(
    "Photograph",
    () => photoNames(viewer).map((name) => [name, name] as const),
    (photo) => act.change({ photo }),
  );
  const compare = choice<Comparison>(
    "Compare with",
    () => [
      ["off", "Nothing"],
      ["environment", "Another light"],
      ["plain", "Image-based light"],
      ...(photoNames(viewer).length > 0 ? ([["photo", "A photograph"]] as const) : []),
    ],
    (next) => {
      const photo = viewer.state.photo || (photoNames(viewer)[0] ?? "");
      act.change({ compare: next, photo, ...(next === "photo" ? asPhotographed(viewer) : {}) });
    },
  );
  const share = sharing(viewer);
  shown.unshift(() => {
    share.show();
    for (const list of [lightsB, compare, photos]) list.refill();
  });
  const pixels = (value: string): HTMLInputElement =>
    make("input", { type: "number", value, min: "16", max: "8192" });
  const size = [pixels("1600"), pixels("1200")];
  const inSize = (save: (width: number, height: number) => void) => () => {
    const [width, height] = size.map((field) =>
      Math.min(Math.max(Math.round(field.valueAsNumber), 16), 8192),
    );
    if (Number.isFinite(width) && Number.isFinite(height)) save(width!, height!);
  };

  const refining = make("p", { className: "hint", hidden: true });
  viewer.on("refine", (status) => {
    refining.textContent = statusText(status);
    refining.hidden = refining.textContent === "";
  });

  const element = make(
    "details",
    { className: "panel", open: true },
    make("summary", { textContent: "Controls" }),
  );
  element.append(
    section(
      "Light",
      true,
      angle("Rotate", "yawDeg"),
      ofTurn("intensity", (change) => slider("Intensity", limits.intensity, 0.05, change)),
      button("Reset light", () => act.reset("light")),
    ),
    section("Tilt of the light", false, angle("About y", "pitchDeg"), angle("About x", "rollDeg")),
    section(
      "Picture",
      true,
      ofLook("channel", (change) => choice("Show", () => channelTexts, change)),
      ofLook("autoExposure", (change) => check("Auto exposure", change)),
      ofLook("exposureEv", (change) => slider("Exposure", limits.exposure, 0.1, change, "EV")),
      ofLook("tone", (change) => choice("Tone curve", () => toneTexts, change)),
      ofLook("background", (change) => choice("Background", () => backgroundTexts, change)),
      follow(
        colourField((backgroundSrgb) => look({ backgroundSrgb, background: "colour" })),
        (state) => state.look.backgroundSrgb,
      ),
      ofLook("indirect", (change) => check("Bounce light", change)),
      ofState("refine", (change) => check("Refine while nothing moves", change)),
      refining,
      ofLook("ground", (change) => check("Shadow on the ground", change)),
      button("Reset picture", () => act.reset("picture")),
    ),
    section(
      "Camera",
      false,
      ofState("free", (change) => check("Look from where no photograph was taken", change)),
      button("Reset camera", () => act.reset("camera")),
    ),
    section(
      "Material",
      false,
      follow(
        slider("Albedo ×", limits.gain, 0.05, (gain) => edit({ albedoGain: [gain, gain, gain] })),
        (state) => state.look.edit.albedoGain[1],
      ),
      ofEdit("roughnessScale", (change) => slider("Roughness ×", limits.roughness, 0.05, change)),
      ofEdit("metalnessShift", (change) => slider("Metalness +", limits.metalness, 0.05, change)),
      button("Reset material", () => act.reset("material")),
    ),
    section(
      "Compare",
      false,
      follow(compare, (state) => state.compare),
      follow(lightsB, (state) => state.environmentB),
      follow(photos, (state) => state.photo),
      ofState("split", (change) => slider("Divide at", [0, 1], 0.01, change)),
    ),
    section(
      "Save",
      false,
      make("label", {}, "Width (pixels)", size[0]!),
      make("label", {}, "Height (pixels)", size[1]!),
      buttons(button("Save PNG", inSize(act.savePng)), button("Save EXR", inSize(act.saveExr))),
      button("Make a film…", act.film),
      button("Copy link to this view", act.copyLink),
    ),
    share.element,
    section(
      "Open and help",
      false,
      buttons(button("Open bundle…", act.openBundle), button("Open folder…", act.openFolder)),
      make("p", {
        className: "hint",
        textContent:
          "Drag or arrow keys: turn the camera. Shift and drag, [ and ]: turn the light. Wheel, two fingers, + and -: " +
          "nearer. Ctrl and drag, Shift and up or down: move.",
      }),
    ),
  );
  return {
    element,
    show: () => {
      for (const each of shown) each();
    },
  };
}

/** Names of photographs that the bundle has both a picture and a camera of. */
export function photoNames(viewer: Viewer): string[] {
  const { cameras = [], previews = [] } = viewer.bundle ?? {};
  return cameras
    .map(({ name }) => name)
    .filter((name) => previews.some((each) => each.name === `photo_${name}.png`));
}

/** Return the light of the photographs, where the bundle has it, as it was. */
function asPhotographed(viewer: Viewer): Partial<ViewerState> {
  const name = viewer.bundle?.trainedMaps[0]?.name;
  return name === undefined ? {} : { environment: `trained:${name}`, turn: initialState.turn };
}

function buttons(...fields: Node[]): HTMLElement {
  return make("div", { className: "buttons" }, ...fields);
}

function colourField(change: (rgb: readonly [number, number, number]) => void): Field<readonly number[]> {
  const input = make("input", { type: "color" });
  input.addEventListener("input", () => {
    const byte = (start: number): number => Number.parseInt(input.value.slice(start, start + 2), 16) / 255;
    change([byte(1), byte(3), byte(5)]);
  });
  return {
    element: make("label", {}, "Background colour", input),
    show: (rgb) => {
      const hex = rgb.map((value) =>
        Math.round(255 * value)
          .toString(16)
          .padStart(2, "0"),
      );
      input.value = `#${hex.join("")}`;
    },
  };
}
