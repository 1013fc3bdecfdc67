/** Turning the camera and the light with pointer, touch, wheel and keyboard. The camera moves by camera-controls. */

import CameraControls from "camera-controls";
import {
  Box3,
  Matrix4,
  PerspectiveCamera,
  Quaternion,
  Raycaster,
  Sphere,
  Spherical,
  Vector2,
  Vector3,
  Vector4,
} from "three";
import type { LightTurn } from "../render/looks.js";
import { axesOf, verticalFieldDeg } from "./camera.js";
import { listening, releases } from "./fields.js";
import { afterKey, type Turned } from "./orbit.js";
import { pick } from "./pick.js";
import { limits, type OrbitPose, wrapped } from "./state.js";
import type { Viewer } from "./viewer.js";

CameraControls.install({
  THREE: { Box3, Matrix4, Quaternion, Raycaster, Sphere, Spherical, Vector2, Vector3, Vector4 },
});

export type CameraActions = {
  readonly change: (next: Partial<Turned>) => void;
  /** Called when something begins to move, and when it has come to rest. */
  readonly moving: (on: boolean) => void;
};

/** Degrees of the light's rotation per pixel. */
const lightDegrees = 0.35;
/** How far two fingers turn before they turn the light. */
const leastTwistDeg = 8;
/** Nearer by this factor with a double click. */
const focusFactor = 0.6;
const farthestTarget = 5;
/** Nobody sees smaller steps: degrees, or radii of the object's box. */
const leastStep = 1e-6;
const isStill = (): boolean => matchMedia("(prefers-reduced-motion: reduce)").matches;

/**
 * The hands of one viewer, until `signal`. The viewer's pose is the one that counts: the controls follow it when someone
 * else has changed it, and no frame is asked for while nothing moves.
 */
export class CameraHands {
  readonly #camera = new PerspectiveCamera();
  readonly #controls: CameraControls;
  /** The pose that the controls have asked for last. */
  #asked: OrbitPose | null = null;
  #frame = 0;
  #updatedAt = 0;
  #held = false;
  #isMoving = false;

  constructor(
    private readonly viewer: Viewer,
    private readonly act: CameraActions,
    signal: AbortSignal,
  ) {
    const { canvas } = viewer;
    this.#camera.up.set(0, 0, 1);
    this.#controls = new CameraControls(this.#camera, canvas);
    const { ACTION } = CameraControls;
    Object.assign(this.#controls, { azimuthRotateSpeed: 0.7, polarRotateSpeed: 0.7 });
    Object.assign(this.#controls.mouseButtons, {
      middle: ACTION.TRUCK,
      right: ACTION.TRUCK,
      wheel: ACTION.NONE,
    });
    const box = new Vector3().setScalar(farthestTarget);
    this.#controls.setBoundary(new Box3(box.clone().negate(), box));
    this.#follow();
    this.#controls.addEventListener("controlstart", () => {
      this.#held = true;
      // What someone takes hold of is a movement of its own, also where the one before has not come to rest.
      this.#move(false);
      this.#move(true);
    });
    this.#controls.addEventListener("controlend", () => {
      this.#held = false;
      this.#run();
    });
    // At once, so that no part of a movement is lost where frames take long.
    this.#controls.addEventListener("control", () => this.#step(performance.now()));
    const stop = viewer.on("change", () => this.#follow());
    this.#listen(canvas, signal);
    signal.addEventListener("abort", () => {
      stop();
      cancelAnimationFrame(this.#frame);
      this.#controls.dispose();
    });
  }

  #listen(canvas: HTMLCanvasElement, signal: AbortSignal): void {
    const on = listening(signal);
    const { ACTION } = CameraControls;
    // Before the controls hear of it.
    const choose = (event: Event): void => {
      if (event.target !== canvas || !(event instanceof PointerEvent)) return;
      this.#follow();
      this.#limit();
      // They hear movements only after an update.
      this.#controls.update(0.001);
      this.#camera.fov = verticalFieldDeg(this.viewer.canvasCamera());
      const left = event.shiftKey ? ACTION.NONE : event.ctrlKey ? ACTION.TRUCK : ACTION.ROTATE;
      this.#controls.mouseButtons.left = left;
      this.#controls.touches.two = ACTION.TOUCH_TRUCK;
    };
    canvas.getRootNode().addEventListener("pointerdown", choose, { signal, capture: true });
    on(canvas, "contextmenu", (event) => event.preventDefault());
    on(canvas, "dblclick", (event) => this.#focus(event));
    on(canvas, "keydown", (event) => {
      const next = afterKey(event, this.viewer.state, this.viewer.elevationRange);
      if (next === null) return;
      event.preventDefault();
      this.act.change(next);
    });
    const wheel = (event: WheelEvent): void => {
      event.preventDefault();
      this.#follow();
      const unit = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
      const { radius } = this.#controls.getSpherical(new Spherical());
      this.#controls.dollyTo(radius * Math.exp(0.0012 * unit * event.deltaY), true);
      this.#run();
    };
    canvas.addEventListener("wheel", wheel, { signal, passive: false });
    listenToFingers(canvas, {
      turn: () => this.viewer.state.turn,
      change: (turn) => this.act.change({ turn }),
      // Two fingers that turn the light do not move the camera.
      twisting: () => {
        this.#controls.touches.two = ACTION.NONE;
      },
      // What is between the fingers grows as they part.
      pinch: (factor) => {
        const { radius } = this.#controls.getSpherical(new Spherical());
        void this.#controls.dollyTo(factor * radius, true);
        this.#step(performance.now());
      },
      signal,
    });
  }

  /** Take the pose of the state over where it is not the controls' own. */
  #follow(): void {
    const { pose } = this.viewer.state;
    if (pose === this.#asked) return;
    this.#asked = pose;
    this.#limit();
    const { back } = axesOf(pose);
    const eye = pose.target.map((value, axis) => value + pose.distance * back[axis]!);
    const [ex, ey, ez] = eye;
    const [tx, ty, tz] = pose.target;
    void this.#controls.setLookAt(ex!, ey!, ez!, tx, ty, tz, false);
    this.#controls.update(0);
  }

  #limit(): void {
    const polar = (elevationDeg: number): number => ((90 - elevationDeg) * Math.PI) / 180;
    const { pose } = this.viewer.state;
    const [lowest, highest] = this.viewer.elevationRange;
    // A pose outside, which a link may have, does not jump.
    const [low, high] = [Math.min(lowest, pose.elevationDeg), Math.max(highest, pose.elevationDeg)];
    const [least, most] = limits.distance;
    Object.assign(this.#controls, { minPolarAngle: polar(high), maxPolarAngle: polar(low) });
    Object.assign(this.#controls, { minDistance: least, maxDistance: most });
    // Without motion everything is where it is going to.
    Object.assign(this.#controls, isStill() ? { smoothTime: 0, draggingSmoothTime: 0 } : smooth);
  }

  /** Look at the point of the surface under the pointer, from nearer. */
  #focus(event: MouseEvent): void {
    const { canvas, bundle, ball } = this.viewer;
    if (bundle === null) return;
    const camera = this.viewer.canvasCamera();
    const box = canvas.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * camera.width;
    const y = ((event.clientY - box.top) / box.height) * camera.height;
    const point = pick(bundle.mesh, camera, x, y);
    if (point === null) return;
    this.#follow();
    const [tx, ty, tz] = point.map((value, axis) => (value - ball.centre[axis]!) / ball.radius);
    void this.#controls.moveTo(tx!, ty!, tz!, true);
    void this.#controls.dollyTo(focusFactor * this.viewer.state.pose.distance, true);
    this.#run();
  }

  /** Ask for frames until everything rests. */
  #run(): void {
    if (this.#frame !== 0) return;
    this.#updatedAt = Math.max(this.#updatedAt, performance.now() - 16);
    this.#move(true);
    this.#frame = requestAnimationFrame((now) => {
      this.#frame = 0;
      this.#step(now);
    });
  }

  #step(now: number): void {
    // With no smoothing a whole second takes everything to its end.
    const seconds = isStill() ? 1 : Math.min(Math.max(now - this.#updatedAt, 1), 100) / 1000;
    this.#updatedAt = now;
    const before = this.viewer.state.pose;
    // Someone else has changed the pose in the meantime: that ends the motion.
    if (before !== this.#asked) {
      this.#follow();
      this.#move(this.#held);
      return;
    }
    if (!this.#controls.update(seconds)) {
      if (!this.#held) this.#move(false);
      return;
    }
    const pose = poseOf(this.#controls, before);
    this.#asked = pose;
    this.act.change({ pose });
    this.#run();
  }

  #move(on: boolean): void {
    if (on === this.#isMoving) return;
    this.#isMoving = on;
    this.act.moving(on);
  }
}

const smooth = { smoothTime: 0.2, draggingSmoothTime: 0.06 };

/** Return where the controls have the camera now; numbers of `before` that they have not changed stay exactly. */
function poseOf(controls: CameraControls, before: OrbitPose): OrbitPose {
  const target = controls.getTarget(new Vector3(), false);
  const back = controls.getPosition(new Vector3(), false).sub(target);
  const distance = back.length();
  const degrees = (angle: number): number => (angle * 180) / Math.PI;
  const kept = (value: number, known: number): number =>
    Math.abs(value - known) < leastStep ? known : value;
  const elevationDeg = degrees(Math.asin(Math.min(Math.max(back.z / distance, -1), 1)));
  const [x, y, z] = before.target;
  return {
    azimuthDeg: kept(wrapped(degrees(Math.atan2(back.y, back.x))), before.azimuthDeg),
    elevationDeg: kept(elevationDeg, before.elevationDeg),
    distance: kept(distance, before.distance),
    target: [kept(target.x, x), kept(target.y, y), kept(target.z, z)],
  };
}

type FingerHost = {
  readonly turn: () => LightTurn;
  readonly change: (turn: LightTurn) => void;
  readonly twisting: () => void;
  /** Two fingers came nearer to each other, by this factor, or parted. */
  readonly pinch: (factor: number) => void;
  readonly signal: AbortSignal;
};

/** Turn the light about +z, with Shift and drag or by turning two fingers, and hear fingers that part or meet. */
function listenToFingers(
  canvas: HTMLCanvasElement,
  { turn, change, twisting, pinch, signal }: FingerHost,
): void {
  const on = listening(signal);
  const points = new Map<number, { x: number; y: number; light: boolean }>();
  let twist = 0;
  let twists = false;
  const between = (): { gap: number; angle: number } => {
    const [a, b] = [...points.values()];
    const [x, y] = a && b ? [b.x - a.x, b.y - a.y] : [0, 0];
    return { gap: Math.hypot(x, y), angle: (Math.atan2(y, x) * 180) / Math.PI };
  };
  const rotate = (degrees: number): void => change({ ...turn(), yawDeg: wrapped(turn().yawDeg + degrees) });
  on(canvas, "pointerdown", (event) => {
    const light = event.shiftKey && event.button === 0;
    points.set(event.pointerId, { x: event.clientX, y: event.clientY, light });
    if (light) canvas.setPointerCapture(event.pointerId);
    twist = 0;
    twists = false;
  });
  on(canvas, "pointermove", (event) => {
    const point = points.get(event.pointerId);
    if (point === undefined) return;
    const before = between();
    const across = event.clientX - point.x;
    Object.assign(point, { x: event.clientX, y: event.clientY });
    if (point.light) rotate(lightDegrees * across);
    if (points.size !== 2) return;
    const after = between();
    const step = wrapped(after.angle - before.angle);
    twist += step;
    twists ||= Math.abs(twist) >= leastTwistDeg;
    if (!twists) {
      if (before.gap > 0 && after.gap > 0) pinch(before.gap / after.gap);
      return;
    }
    twisting();
    // Seen from above, the light goes with the fingers; rows of the screen go down.
    rotate(-step);
  });
  for (const lifted of releases) {
    on(canvas, lifted, (event) => points.delete(event.pointerId));
  }
}
