import { IcosahedronGeometry, TorusKnotGeometry } from "three";
import { describe, expect, it } from "vitest";
import { buildHierarchy } from "../src/refine/hierarchy.js";
import { isClosed, MeshRays } from "../src/refine/meshRays.js";

type Mesh = { positionsXyz: Float32Array<ArrayBuffer>; indices: Uint32Array<ArrayBuffer> };

/** Return numbers in [0, 1) that are the same every time. */
function uniforms(seed: number): () => number {
  let state = seed;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

function knot(along = 60, around = 9): Mesh {
  const geometry = new TorusKnotGeometry(1, 0.35, along, around);
  return {
    positionsXyz: new Float32Array(geometry.attributes.position!.array),
    indices: Uint32Array.from(geometry.index!.array),
  };
}

function soup(count: number, next: () => number): Mesh {
  const positionsXyz = new Float32Array(9 * count);
  for (let face = 0; face < count; face++) {
    const centre = [next(), next(), next()];
    for (let at = 0; at < 9; at++) positionsXyz[9 * face + at] = centre[at % 3]! + 0.2 * (next() - 0.5);
  }
  return { positionsXyz, indices: Uint32Array.from({ length: 3 * count }, (_, index) => index) };
}

/** Return the nearest hit by trying every face. */
function plain({ positionsXyz: p, indices }: Mesh, o: number[], d: number[], oneSided: boolean): number {
  let nearest = Number.POSITIVE_INFINITY;
  const cross = (a: number[], b: number[]) => [
    a[1]! * b[2]! - a[2]! * b[1]!,
    a[2]! * b[0]! - a[0]! * b[2]!,
    a[0]! * b[1]! - a[1]! * b[0]!,
  ];
  const dot = (a: number[], b: number[]) => a[0]! * b[0]! + a[1]! * b[1]! + a[2]! * b[2]!;
  for (let face = 0; face < indices.length; face += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => [
      ...p.subarray(3 * indices[face + k]!, 3 * indices[face + k]! + 3),
    ]);
    const normal = cross(
      b!.map((x, k) => x - a![k]!),
      c!.map((x, k) => x - a![k]!),
    );
    const slope = dot(normal, d);
    if (slope === 0 || (oneSided && slope > 0)) continue;
    const t = (dot(normal, a!) - dot(normal, o)) / slope;
    if (t <= 0 || t >= nearest) continue;
    const at = o.map((x, k) => x + t * d[k]!);
    const inside = [
      [a, b],
      [b, c],
      [c, a],
    ].every(([from, to]) => {
      const edge = to!.map((x, k) => x - from![k]!);
      return (
        dot(
          cross(
            edge,
            at.map((x, k) => x - from![k]!),
          ),
          normal,
        ) >= 0
      );
    });
    if (inside) nearest = t;
  }
  return nearest;
}

describe("rays against a mesh", () => {
  it.each([
    ["a closed knot", knot(), true],
    ["loose triangles", soup(300, uniforms(5)), false],
    ["one triangle", soup(1, uniforms(9)), false],
  ] as const)("meet what they meet when every face is tried: %s", (_, mesh, closed) => {
    const rays = new MeshRays(mesh);
    expect(rays.oneSided).toBe(closed);
    const next = uniforms(1);
    let hits = 0;
    for (let ray = 0; ray < 400; ray++) {
      const origin = [0, 1, 2].map(() => 3 * next() - 1.5);
      const towards = [0, 1, 2].map((axis) => next() - (closed ? 0.5 : origin[axis]!));
      // Some along an axis, where a box's border is at infinity.
      const raw = ray % 7 === 0 ? [0, 0, 1] : towards;
      const length = Math.hypot(...raw);
      const direction = raw.map((x) => x / length);
      const [ox, oy, oz] = origin as [number, number, number];
      const [dx, dy, dz] = direction as [number, number, number];
      const found = rays.distance(ox, oy, oz, dx, dy, dz);
      const wanted = plain(mesh, origin, direction, closed);
      if (Number.isFinite(wanted)) hits++;
      if (Number.isFinite(wanted) !== Number.isFinite(found)) expect(found).toBe(wanted);
      else if (Number.isFinite(wanted)) {
        expect(found).toBeCloseTo(wanted, 5);
        // The place on the face is where the ray is by then.
        const at = [0, 1, 2].map((k) => {
          const corner = (c: number): number => mesh.positionsXyz[3 * mesh.indices[3 * rays.face + c]! + k]!;
          return (1 - rays.u - rays.v) * corner(0) + rays.u * corner(1) + rays.v * corner(2);
        });
        at.forEach((value, k) => {
          expect(value).toBeCloseTo(origin[k]! + found * direction[k]!, 5);
        });
      } else expect(rays.face).toBe(-1);
    }
    if (mesh.indices.length > 3) expect(hits).toBeGreaterThan(40);
  });

  it("leave a closed surface from below it", () => {
    const positionsXyz = new Float32Array(new IcosahedronGeometry(1, 2).attributes.position!.array);
    const indices = Uint32Array.from({ length: positionsXyz.length / 3 }, (_, index) => index);
    const closed = new MeshRays({ positionsXyz, indices });
    const open = new MeshRays({ positionsXyz, indices: indices.slice(0, -3) });
    expect([closed.oneSided, open.oneSided]).toEqual([true, false]);
    // From the middle of the first face, a little below it.
    const out = [0, 1, 2].map((k) => (positionsXyz[k]! + positionsXyz[3 + k]! + positionsXyz[6 + k]!) / 3);
    const below = out.map((x) => 0.99 * x) as [number, number, number];
    const direction = out.map((x) => x / Math.hypot(...out)) as [number, number, number];
    expect(open.distance(...below, ...direction)).toBeLessThan(0.05);
    expect(closed.distance(...below, ...direction)).toBe(Number.POSITIVE_INFINITY);
  });

  it("find a mesh closed by places, and open where an edge has one face more", () => {
    const { positionsXyz, indices } = knot(12, 5);
    expect(isClosed(positionsXyz, indices)).toBe(true);
    expect(isClosed(positionsXyz, indices.slice(3))).toBe(false);
    // One face turned over has its edges on the wrong side.
    const turned = indices.slice();
    [turned[0], turned[1]] = [turned[1]!, turned[0]!];
    expect(isClosed(positionsXyz, turned)).toBe(false);
  });
});

describe("a hierarchy", () => {
  it("has every face in one leaf, inside the boxes above it", () => {
    const { positionsXyz, indices } = knot();
    const { boxes, children, counts, corners } = buildHierarchy(positionsXyz, indices);
    const seen = new Set<number>();
    const visit = (node: number, limits: number[]): void => {
      for (const side of [0, 1]) {
        const box = [...boxes.subarray(12 * node + 6 * side, 12 * node + 6 * side + 6)];
        for (const axis of [0, 1, 2]) {
          expect(box[axis]).toBeGreaterThanOrEqual(limits[axis]!);
          expect(box[3 + axis]).toBeLessThanOrEqual(limits[3 + axis]!);
        }
        const child = children[2 * node + side]!;
        if (child > 0) visit(child, box);
        for (let place = -1 - child; child < 0 && place < -1 - child + counts[2 * node + side]!; place++) {
          expect(seen.has(place)).toBe(false);
          seen.add(place);
          for (const axis of [0, 1, 2]) {
            for (const edge of [0, 3, 6]) {
              const at = corners[9 * place + axis]! + (edge ? corners[9 * place + edge + axis]! : 0);
              expect(at).toBeGreaterThanOrEqual(box[axis]! - 1e-6);
              expect(at).toBeLessThanOrEqual(box[3 + axis]! + 1e-6);
            }
          }
        }
      }
    };
    const far = Number.POSITIVE_INFINITY;
    visit(0, [-far, -far, -far, far, far, far]);
    expect(seen.size).toBe(indices.length / 3);
  });

  it("ends where all faces are at one place", () => {
    const one = new Float32Array([0, 0, 0, 1, 0, 0, 0, 1, 0]);
    const many = Uint32Array.from({ length: 3000 }, (_, index) => index % 3);
    const rays = new MeshRays({ positionsXyz: one, indices: many });
    expect(rays.distance(0.2, 0.2, 1, 0, 0, -1)).toBeCloseTo(1, 6);
  });
});
