/** A ball on the picture that shows where the main light comes from; who drags it turns the light. */

import type { Direction } from "../engine/environment.js";
import type { LightTurn } from "../render/looks.js";
import { axesOf } from "./camera.js";
import { listening, make, releases } from "./fields.js";
import { turned, turnedAbout, turnFor } from "./turning.js";
import type { Viewer } from "./viewer.js";
import { fillIn, texts } from "../words/words.js";

export type BallActions = {
  readonly turn: (turn: LightTurn) => void;
  readonly moving: (on: boolean) => void;
};

const keyDegrees = 5;
const vertical: Direction = [0, 0, 1];

/** Build the ball; `show` follows the viewer's state. */
export function lightBall(viewer: Viewer, act: BallActions, signal: AbortSignal) {
  const on = listening(signal);
  const dot = make("span", { className: "dot" });
  const element = make(
    "div",
    {
      ...{ className: "ball", tabIndex: 0, role: "slider", ariaLabel: texts.light.direction },
      ...{ ariaValueMin: "-180", ariaValueMax: "180" },
      title: texts.light.ball,
    },
    dot,
  );

  const turnBy = (right: number, up: number): void => {
    const { turn, pose } = viewer.state;
    const level = right === 0 ? turn : turnedAbout(turn, vertical, right);
    act.turn(up === 0 ? level : turnedAbout(level, axesOf(pose).right, -up));
  };
  const reset = (): void => {
    const { environment, turn } = viewer.state;
    const home = turnFor(environment, viewer.homeTurn);
    act.turn(turn.intensity === home.intensity ? home : { ...home, intensity: turn.intensity });
  };

  hearFingers(element, on, turnBy, act.moving);
  on(element, "dblclick", reset);
  on(element, "keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = {
      ArrowLeft: [-keyDegrees, 0],
      ArrowRight: [keyDegrees, 0],
      ArrowUp: [0, keyDegrees],
      ArrowDown: [0, -keyDegrees],
    }[event.key];
    if (step === undefined && event.key !== "Home") return;
    event.preventDefault();
    if (step === undefined) reset();
    else turnBy(step[0]!, step[1]!);
  });

  let shown = "";
  const show = (): void => {
    const main = viewer.mainLight;
    const { turn, pose } = viewer.state;
    const { right, up, back } = axesOf(pose);
    const towards = main === null ? null : turned(main, turn);
    const along = (axis: readonly number[]): number =>
      towards === null ? 0 : towards[0] * axis[0]! + towards[1] * axis[1]! + towards[2] * axis[2]!;
    const [x, y, z] = [along(right), along(up), along(back)];
    const key = `${x.toFixed(3)} ${y.toFixed(3)} ${z > 0} ${main === null}`;
    if (key === shown) return;
    shown = key;
    dot.hidden = towards === null;
    dot.style.left = `${50 + 42 * x}%`;
    dot.style.top = `${50 - 42 * y}%`;
    light(element, x, y, z);
    name(element, towards, turn);
  };
  return { element, show };
}

/** Turn as a finger or the mouse drags: what is in front follows it. */
function hearFingers(
  element: HTMLElement,
  on: ReturnType<typeof listening>,
  turnBy: (right: number, up: number) => void,
  moving: (on: boolean) => void,
): void {
  let last: { readonly id: number; x: number; y: number } | null = null;
  on(element, "pointerdown", (event) => {
    if (event.button !== 0 || last !== null) return;
    element.setPointerCapture(event.pointerId);
    last = { id: event.pointerId, x: event.clientX, y: event.clientY };
    moving(true);
  });
  on(element, "pointermove", (event) => {
    if (last?.id !== event.pointerId) return;
    const perPixel = 180 / Math.max(element.clientWidth, 1);
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    last = { id: event.pointerId, x: event.clientX, y: event.clientY };
    if (dx !== 0 || dy !== 0) turnBy(perPixel * dx, -perPixel * dy);
  });
  for (const lifted of releases) {
    on(element, lifted, (event) => {
      if (last?.id !== event.pointerId) return;
      last = null;
      moving(false);
    });
  }
}

/** Paint the lit side of the ball; light from behind leaves a rim. */
function light(element: HTMLElement, x: number, y: number, z: number): void {
  const dark = Math.max(0, -z);
  element.classList.toggle("behind", z < 0);
  element.style.backgroundImage = `radial-gradient(circle at ${50 + 45 * x}% ${50 - 45 * y}%, #f4f6f8 ${
    8 - 8 * dark
  }%, #8d959e ${45 - 30 * dark}%, #2a2f36 ${95 - 45 * dark}%)`;
}

/** Say where the light comes from to those who do not see it. */
function name(element: HTMLElement, towards: Direction | null, turn: LightTurn): void {
  const deg = (angle: number): number => Math.round((angle * 180) / Math.PI);
  if (towards === null) {
    element.ariaValueNow = String(Math.round(turn.yawDeg));
    element.ariaValueText = texts.light.allSides;
    return;
  }
  const azimuth = deg(Math.atan2(towards[1], towards[0]));
  const elevation = deg(Math.asin(Math.min(Math.max(towards[2], -1), 1)));
  element.ariaValueNow = String(azimuth);
  element.ariaValueText = fillIn(texts.light.angles, { azimuth, elevation });
}
