/** The controls next to the picture. */

import type { BackgroundKind, Channel, LightTurn, Look, MaterialEdit, ToneCurve } from "../render/looks.js";
import { button, check, choice, type Field, make, section, slider } from "./fields.js";
import { lightTexts } from "./lightTexts.js";
import type { ResetPart } from "./resets.js";
import { sharing } from "./sharing.js";
import { type Comparison, initialState, limits, type ViewerState } from "./state.js";
import type { Viewer } from "./viewer.js";
import { statusText } from "../refine/status.js";
import { texts } from "../words/words.js";

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

/** Return the choices of a field by their names in the state. */
const choicesOf = <T extends string>(names: Readonly<Record<T, string>>) =>
  Object.entries(names) as [T, string][];

/** Return what makes fields that change the viewer's state, and follow it when they are `show`n. */
function fieldsFor(viewer: Viewer, act: PanelActions) {
  const shown: (() => void)[] = [];
  const follow = <T>(field: Field<T>, value: (state: ViewerState) => T): HTMLElement => {
    shown.push(() => field.show(value(viewer.state)));
    return field.element;
  };
  const look = (part: Partial<Look>): void => act.change({ look: { ...viewer.state.look, ...part } });
  const edit = (part: Partial<MaterialEdit>): void => look({ edit: { ...viewer.state.look.edit, ...part } });
  const turn = (part: Partial<LightTurn>): void => act.change({ turn: { ...viewer.state.turn, ...part } });

  /** Return what makes fields of a part of the state, by their name in it. */
  const of =
    <T>(part: (state: ViewerState) => T, change: (part: Partial<T>) => void) =>
    <K extends keyof T>(name: K, field: (change: (value: T[K]) => void) => Field<T[K]>): HTMLElement => {
      const made = field((value) => change({ [name]: value } as unknown as Partial<T>));
      return follow(made, (state) => part(state)[name]);
    };
  return {
    ...{ viewer, act, shown, follow, look, edit },
    ofState: of((state) => state, act.change),
    ofLook: of((state) => state.look, look),
    ofEdit: of((state) => state.look.edit, edit),
    ofTurn: of((state) => state.turn, turn),
  };
}
type Fields = ReturnType<typeof fieldsFor>;

/** Build the panel; the result follows the viewer's state. */
export function buildPanel(
  viewer: Viewer,
  act: PanelActions,
): { element: HTMLDetailsElement; show: () => void } {
  const fields = fieldsFor(viewer, act);
  const share = sharing(viewer);
  fields.shown.push(share.show);
  const element = make(
    "details",
    { className: "panel", open: true },
    make("summary", { textContent: texts.panel.controls }),
    ...lightSections(fields),
    pictureSection(fields),
    cameraSection(fields),
    materialSection(fields),
    compareSection(fields),
    saveSection(act),
    share.element,
    section(
      texts.panel.open,
      false,
      buttons(button(texts.panel.openBundle, act.openBundle), button(texts.panel.openFolder, act.openFolder)),
      make("p", { className: "hint", textContent: texts.panel.help }),
    ),
  );
  return {
    element,
    show: () => {
      for (const each of fields.shown) each();
    },
  };
}

function lightSections({ act, ofTurn }: Fields): HTMLElement[] {
  const angle = (label: string, part: "yawDeg" | "pitchDeg" | "rollDeg"): HTMLElement =>
    ofTurn(part, (change) => slider(label, limits.angle, 1, change, "°"));
  return [
    section(
      texts.panel.light,
      true,
      angle(texts.panel.rotate, "yawDeg"),
      ofTurn("intensity", (change) => slider(texts.panel.intensity, limits.intensity, 0.05, change)),
      button(texts.panel.resetLight, () => act.reset("light")),
    ),
    section(
      texts.panel.tilt,
      false,
      angle(texts.panel.aboutY, "pitchDeg"),
      angle(texts.panel.aboutX, "rollDeg"),
    ),
  ];
}

function pictureSection(fields: Fields): HTMLElement {
  const { act, follow, look, ofLook } = fields;
  return section(
    texts.panel.picture,
    true,
    ofLook("channel", (change) =>
      choice(texts.panel.show, () => choicesOf<Channel>(texts.panel.channels), change),
    ),
    ofLook("autoExposure", (change) => check(texts.panel.autoExposure, change)),
    ofLook("exposureEv", (change) => slider(texts.panel.exposure, limits.exposure, 0.1, change, "EV")),
    ofLook("tone", (change) =>
      choice(texts.panel.tone, () => choicesOf<ToneCurve>(texts.panel.tones), change),
    ),
    ofLook("background", (change) =>
      choice(texts.panel.background, () => choicesOf<BackgroundKind>(texts.panel.backgrounds), change),
    ),
    follow(
      colourField((backgroundSrgb) => look({ backgroundSrgb, background: "colour" })),
      (state) => state.look.backgroundSrgb,
    ),
    ofLook("indirect", (change) => check(texts.panel.indirect, change)),
    fields.ofState("refine", (change) => check(texts.panel.refine, change)),
    ...refiningFields(fields),
    ofLook("ground", (change) => check(texts.panel.ground, change)),
    button(texts.panel.resetPicture, () => act.reset("picture")),
  );
}

/** What rays of refined pictures are traced against, and how far refining is. */
function refiningFields({ viewer, shown, follow }: Fields): HTMLElement[] {
  const rays = choice(
    texts.panel.rays,
    () => choicesOf<"mesh" | "cache">(texts.panel.raysOf),
    (backend) => {
      viewer.refineOptions = { ...viewer.refineOptions, backend };
    },
  );
  const box = follow(rays, () => (viewer.refineOptions.backend === "mesh" ? "mesh" : "cache"));
  shown.push(() => {
    box.hidden = !viewer.state.refine;
  });
  const status = make("p", { className: "hint", hidden: true });
  viewer.on("refine", (now) => {
    status.textContent = statusText(now);
    status.hidden = status.textContent === "";
  });
  return [box, status];
}

function cameraSection({ act, ofState }: Fields): HTMLElement {
  return section(
    texts.panel.camera,
    false,
    ofState("free", (change) => check(texts.panel.free, change)),
    button(texts.panel.resetCamera, () => act.reset("camera")),
  );
}

function materialSection({ act, follow, edit, ofEdit }: Fields): HTMLElement {
  return section(
    texts.panel.material,
    false,
    follow(
      slider(texts.panel.albedo, limits.gain, 0.05, (gain) => edit({ albedoGain: [gain, gain, gain] })),
      (state) => state.look.edit.albedoGain[1],
    ),
    ofEdit("roughnessScale", (change) => slider(texts.panel.roughness, limits.roughness, 0.05, change)),
    ofEdit("metalnessShift", (change) => slider(texts.panel.metalness, limits.metalness, 0.05, change)),
    button(texts.panel.resetMaterial, () => act.reset("material")),
  );
}

function compareSection({ viewer, act, shown, follow, ofState }: Fields): HTMLElement {
  const lights = choice(
    texts.panel.onTheRight,
    () => lightTexts(viewer),
    (environmentB) => act.change({ environmentB }),
  );
  const photos = choice(
    texts.panel.photograph,
    () => photoNames(viewer).map((name) => [name, name] as const),
    (photo) => act.change({ photo }),
  );
  const compare = choice<Comparison>(
    texts.panel.compareWith,
    () => [
      ["off", texts.panel.nothing],
      ["environment", texts.panel.otherLight],
      ["plain", texts.panel.plain],
      ...(photoNames(viewer).length > 0 ? ([["photo", texts.panel.aPhotograph]] as const) : []),
    ],
    (next) => {
      const photo = viewer.state.photo || (photoNames(viewer)[0] ?? "");
      act.change({ compare: next, photo, ...(next === "photo" ? asPhotographed(viewer) : {}) });
    },
  );
  // Before a value is shown, the list must have it.
  shown.push(() => {
    for (const list of [lights, compare, photos]) list.refill();
  });
  return section(
    texts.panel.compare,
    false,
    follow(compare, (state) => state.compare),
    follow(lights, (state) => state.environmentB),
    follow(photos, (state) => state.photo),
    ofState("split", (change) => slider(texts.panel.divideAt, [0, 1], 0.01, change)),
  );
}

function saveSection(act: PanelActions): HTMLElement {
  const pixels = (value: string): HTMLInputElement =>
    make("input", { type: "number", value, min: "16", max: "8192" });
  const size = [pixels("1600"), pixels("1200")];
  const inSize = (save: (width: number, height: number) => void) => () => {
    const [width, height] = size.map((field) =>
      Math.min(Math.max(Math.round(field.valueAsNumber), 16), 8192),
    );
    if (Number.isFinite(width) && Number.isFinite(height)) save(width!, height!);
  };
  return section(
    texts.panel.save,
    false,
    make("label", {}, texts.panel.width, size[0]!),
    make("label", {}, texts.panel.height, size[1]!),
    buttons(
      button(texts.panel.savePng, inSize(act.savePng)),
      button(texts.panel.saveExr, inSize(act.saveExr)),
    ),
    button(texts.panel.film, act.film),
    button(texts.panel.copyLink, act.copyLink),
  );
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
    element: make("label", {}, texts.panel.backgroundColour, input),
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
