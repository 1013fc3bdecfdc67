/** A prepared light on the graphics card, rotated as set. */

import { type DataTexture, Euler, MathUtils, Matrix4, type WebGLRenderTarget } from "three";
import type { Direction } from "../engine/environment.js";
import type { FallingLight } from "../engine/fallingLight.js";
import { cosineFactors, type Matrix3, rotate, rotateZ } from "../engine/harmonics.js";
import type { PreparedLight } from "../light/prepare.js";
import { groundTable } from "./ground.js";
import { AtlasLight } from "./irradiance.js";
import type { LightTurn } from "./looks.js";
import { type CastLights, ShadowMaps } from "./shadowMaps.js";
import { type BundleTextures, levelsTexture } from "./textures.js";

type Tilted = {
  readonly key: string;
  readonly coefficientsRgb: Float64Array;
  readonly plainRgb: Float64Array;
};

/** Return rows of the matrix of a turn: about +x by roll, then about +y by pitch, then about +z by yaw. */
export function turnMatrix({ yawDeg, pitchDeg, rollDeg }: LightTurn): Matrix3 {
  const [x, y, z] = [rollDeg, pitchDeg, yawDeg].map(MathUtils.degToRad);
  const { elements: e } = new Matrix4().makeRotationFromEuler(new Euler(x, y, z, "ZYX"));
  return [
    [e[0], e[4], e[8]],
    [e[1], e[5], e[9]],
    [e[2], e[6], e[10]],
  ];
}

/** One light and the irradiance it gives. */
export class StageLight {
  readonly levels: DataTexture;
  readonly places: Int32Array;
  readonly tables: AtlasLight;
  /** Of the turn whose irradiance `tables` holds. */
  drawnTurn: string | null = null;
  /** Turn, and fineness, of the shadow that `ground` holds. */
  drawnGround: string | null = null;
  #ground: WebGLRenderTarget | null = null;
  #shadows: ShadowMaps | null = null;
  #tilted: Tilted | null = null;

  constructor(
    readonly prepared: PreparedLight,
    textures: BundleTextures,
  ) {
    this.levels = levelsTexture(prepared);
    this.places = Int32Array.from(prepared.levels.places.flat());
    this.tables = new AtlasLight(textures);
  }

  /** Shadows of its dominant lights; created on first use, null where it has none. */
  get shadows(): ShadowMaps | null {
    if (this.prepared.lights.length === 0) return null;
    this.#shadows ??= new ShadowMaps();
    return this.#shadows;
  }

  /** Its shadow on the ground; created on first use. */
  get ground(): WebGLRenderTarget {
    this.#ground ??= groundTable();
    return this.#ground;
  }

  /** Return the light as it falls after a turn. */
  falling(turn: LightTurn): FallingLight {
    const { bands } = this.prepared;
    const { intensity } = turn;
    return {
      coefficientsRgb: rotateZ(this.#tilt(turn).coefficientsRgb, bands, turn.yawDeg).map(
        (value) => value * intensity,
      ),
      bands,
      ...this.dominant(turn),
    };
  }

  /** Return the directions of the dominant lights after a turn, and their irradiance. */
  dominant(turn: LightTurn): Pick<FallingLight, "directions" | "irradianceRgb"> {
    const { lights } = this.prepared;
    const matrix = turnMatrix(turn);
    return {
      directions: lights.map(({ direction }) => apply(matrix, direction)),
      irradianceRgb: lights.map(({ radianceSolidAngle }) =>
        radianceSolidAngle.map((value) => value * turn.intensity),
      ),
    };
  }

  /** Return the directions of the dominant lights after a turn, and their radii. */
  cast(turn: LightTurn): CastLights {
    return { directions: this.dominant(turn).directions, radiiRad: this.prepared.lightRadiiRad };
  }

  /** Return harmonics of irradiance without shadows, three bands, [9, 3]. */
  plainIrradiance(turn: LightTurn): Float32Array {
    const turned = rotateZ(this.#tilt(turn).plainRgb, 3, turn.yawDeg);
    const factors = cosineFactors(3);
    return Float32Array.from(
      turned,
      (value, index) => value * factors[Math.floor(index / 3)]! * turn.intensity,
    );
  }

  /** Tilting costs more than turning about +z, so that its result is kept. */
  #tilt(turn: LightTurn): Tilted {
    const { pitchDeg, rollDeg } = turn;
    const key = `${pitchDeg} ${rollDeg}`;
    if (this.#tilted?.key !== key) {
      const { coefficientsRgb, plainRgb, bands } = this.prepared;
      const level = pitchDeg === 0 && rollDeg === 0;
      const matrix = turnMatrix({ ...turn, yawDeg: 0 });
      this.#tilted = {
        key,
        coefficientsRgb: level ? coefficientsRgb : rotate(coefficientsRgb, bands, matrix),
        plainRgb: level ? plainRgb : rotate(plainRgb, 3, matrix),
      };
    }
    return this.#tilted;
  }

  dispose(): void {
    this.levels.dispose();
    this.tables.dispose();
    this.#ground?.dispose();
    this.#shadows?.dispose();
  }
}

function apply(matrix: Matrix3, [x, y, z]: Direction): Direction {
  const at = (r: 0 | 1 | 2): number => matrix[r][0] * x + matrix[r][1] * y + matrix[r][2] * z;
  return [at(0), at(1), at(2)];
}
