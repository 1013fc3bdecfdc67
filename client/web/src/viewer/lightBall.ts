/** A ball on the picture that shows where the main light comes from; who drags it turns the light. */

import type { Direction } from "../engine/environment.js";
import type { LightTurn } from "../render/looks.js";
import { axesOf } from "./camera.js";
import { listening, make, releases } from "./fields.js";
import { turnFor } from "./turning.js";
import { turned, turnedAbout } from "./turning.js";
import type { Viewer } from "./viewer.js";
import { fillIn, texts } from "../words/words.js";

/** What the ball asks for. */
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

  let last: { readonly id: number; x: number; y: number } | null = null;
  on(element, "pointerdown", (event) => {
    if (event.button !== 0 || last !== null) return;
    element.setPointerCapture(event.pointerId);
    last = { id: event.pointerId, x: event.clientX, y: event.clientY };
    act.moving(true);
  });
  on(element, "pointermove", (event) => {
    if (last?.id !== event.pointerId) return;
    // What is in front follows the finger.
    const perPixel = 180 / Math.max(element.clientWidth, 1);
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    last = { id: event.pointerId, x: event.clientX, y: event.clientY };
    if (dx !== 0 || dy !== 0) turnBy(perPixel * dx, -perPixel * dy);
  });
  for (const lifted of releases) {
    on(element, lifted, (event) => {
      if (last?.id !== event.pointerId) return;
      last = null;
      act.moving(false);
    });
  }
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
  function show(): void {
    const { turn, pose } = viewer.state;
    const main = viewer.mainLight;
    const towards = main === null ? null : turned(main, turn);
    const { right, up, back } = axesOf(pose);
    const along = (axis: readonly number[]): number =>
      towards === null ? 0 : towards[0] * axis[0]! + towards[1] * axis[1]! + towards[2] * axis[2]!;
    const [x, y, z] = [along(right), along(up), along(back)];
    const key = `${x.toFixed(3)} ${y.toFixed(3)} ${z > 0} ${main === null}`;
    if (key === shown) return;
    shown = key;
    dot.hidden = towards === null;
    element.classList.toggle("behind", z < 0);
    dot.style.left = `${50 + 42 * x}%`;
    dot.style.top = `${50 - 42 * y}%`;
    // The lit side of the ball; light from behind leaves a rim.
    const dark = Math.max(0, -z);
    element.style.backgroundImage = `radial-gradient(circle at ${50 + 45 * x}% ${50 - 45 * y}%, #f4f6f8 ${
      8 - 8 * dark
    }%, #8d959e ${45 - 30 * dark}%, #2a2f36 ${95 - 45 * dark}%)`;
    const deg = (angle: number): number => Math.round((angle * 180) / Math.PI);
    const azimuth = towards === null ? turn.yawDeg : deg(Math.atan2(towards[1], towards[0]));
    element.ariaValueNow = String(Math.round(azimuth));
    element.ariaValueText =
      towards === null
        ? texts.light.allSides
        : fillIn(texts.light.angles, {
            azimuth,
            elevation: deg(Math.asin(Math.min(Math.max(towards[2], -1), 1))),
          });
  }
  return { element, show };
}
