/** SHA-256, by the browser where it offers it: pages that were fetched over plain HTTP have no `crypto.subtle`. */

const roundConstants = primeRoots(64, 1 / 3);
const firstState = primeRoots(8, 1 / 2);

/** Return the first 32 bits of the fractional parts of roots of the first primes. */
function primeRoots(count: number, power: number): Uint32Array {
  const primes: number[] = [];
  for (let candidate = 2; primes.length < count; candidate++) {
    if (primes.every((prime) => candidate % prime !== 0)) primes.push(candidate);
  }
  return Uint32Array.from(primes, (prime) => {
    const root = prime ** power;
    return (root - Math.floor(root)) * 2 ** 32;
  });
}

/** Return the digest of `data` as lower-case hexadecimal. */
export async function sha256Hex(data: Uint8Array<ArrayBuffer>): Promise<string> {
  const subtle = globalThis.crypto?.subtle;
  const digest = subtle ? new Uint8Array(await subtle.digest("SHA-256", data)) : sha256(data);
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Return the digest of `data`, 32 bytes; FIPS 180-4. */
export function sha256(data: Uint8Array): Uint8Array {
  const state = Uint32Array.from(firstState);
  const whole = data.length - (data.length % 64);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  for (let start = 0; start < whole; start += 64) compress(state, view, start);
  const rest = data.subarray(whole);
  const tail = new Uint8Array(rest.length < 56 ? 64 : 128);
  tail.set(rest);
  tail[rest.length] = 0x80;
  const end = new DataView(tail.buffer);
  end.setUint32(tail.length - 8, Math.floor((data.length * 8) / 2 ** 32));
  end.setUint32(tail.length - 4, (data.length * 8) >>> 0);
  for (let start = 0; start < tail.length; start += 64) compress(state, end, start);
  const digest = new DataView(new ArrayBuffer(32));
  state.forEach((word, index) => {
    digest.setUint32(4 * index, word);
  });
  return new Uint8Array(digest.buffer);
}

type Eight = [number, number, number, number, number, number, number, number];

const schedule = new Uint32Array(64);

function turned(word: number, by: number): number {
  return (word >>> by) | (word << (32 - by));
}

function compress(state: Uint32Array, view: DataView, start: number): void {
  const w = schedule;
  for (let t = 0; t < 16; t++) w[t] = view.getUint32(start + 4 * t);
  for (let t = 16; t < 64; t++) {
    const [late, early] = [w[t - 2]!, w[t - 15]!];
    const fromLate = turned(late, 17) ^ turned(late, 19) ^ (late >>> 10);
    const fromEarly = turned(early, 7) ^ turned(early, 18) ^ (early >>> 3);
    w[t] = (fromLate + w[t - 7]! + fromEarly + w[t - 16]!) | 0;
  }
  let [a, b, c, d, e, f, g, h] = state as Iterable<number> as Eight;
  for (let t = 0; t < 64; t++) {
    const upper = turned(e, 6) ^ turned(e, 11) ^ turned(e, 25);
    const first = (h + upper + ((e & f) ^ (~e & g)) + roundConstants[t]! + w[t]!) | 0;
    const lower = turned(a, 2) ^ turned(a, 13) ^ turned(a, 22);
    const second = (lower + ((a & b) ^ (a & c) ^ (b & c))) | 0;
    [h, g, f, e, d, c, b, a] = [g, f, e, (d + first) | 0, c, b, a, (first + second) | 0];
  }
  [a, b, c, d, e, f, g, h].forEach((word, index) => {
    state[index] = state[index]! + word;
  });
}
