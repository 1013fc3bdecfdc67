/**
 * The protobuf wire format, as far as looking into and trimming an ONNX file needs it: a message is a list of
 * fields, each a key (number and wire type) and a value. The same as lambent_relight/bundle/onnx_wire.py.
 */

const decoder = new TextDecoder("utf-8", { fatal: true });
const encoder = new TextEncoder();

/** One field of a message. */
export type WireField = {
  readonly number: number;
  /** A number, or the bytes of text, a message or a value of fixed size. */
  readonly value: number | Uint8Array;
  /** Key and value as they stand in the message. */
  readonly raw: Uint8Array;
};

/** Return the fields of a message in order; throws RangeError for bytes that are no message. */
export function wireFields(data: Uint8Array): WireField[] {
  const found: WireField[] = [];
  let at = 0;
  const varint = (): number => {
    let value = 0;
    for (let factor = 1; factor < 2 ** 64; factor *= 128) {
      const byte = data[at++];
      if (byte === undefined) throw new RangeError("a message ends inside a number");
      value += (byte & 127) * factor;
      if (byte < 128) return value;
    }
    throw new RangeError("a number is too long");
  };
  while (at < data.length) {
    const start = at;
    const key = varint();
    const [number, wire] = [Math.floor(key / 8), key % 8];
    if (wire === 0) {
      const value = varint();
      found.push({ number, value, raw: data.subarray(start, at) });
      continue;
    }
    const size = wire === 2 ? varint() : wire === 1 ? 8 : wire === 5 ? 4 : -1;
    if (size < 0 || at + size > data.length) throw new RangeError("a field runs over the end");
    const value = data.subarray(at, at + size);
    at += size;
    found.push({ number, value, raw: data.subarray(start, at) });
  }
  return found;
}

/** Return the bytes of a message or text field. */
export function wireBytes(field: WireField): Uint8Array {
  if (typeof field.value === "number") throw new RangeError("a number where a message belongs");
  return field.value;
}

/** Return a text field. */
export function wireText(field: WireField): string {
  return decoder.decode(wireBytes(field));
}

/** Return a field that holds a message or text. */
export function encodedField(number: number, value: Uint8Array | string): Uint8Array {
  const bytes = typeof value === "string" ? encoder.encode(value) : value;
  return joined([encodedVarint(number * 8 + 2), encodedVarint(bytes.length), bytes]);
}

/** Return a field that holds a number. */
export function encodedNumber(number: number, value: number): Uint8Array {
  return joined([encodedVarint(number * 8), encodedVarint(value)]);
}

/** Return byte arrays after each other. */
export function joined(parts: readonly Uint8Array[]): Uint8Array<ArrayBuffer> {
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

function encodedVarint(value: number): Uint8Array {
  const bytes: number[] = [];
  for (; value >= 128; value = Math.floor(value / 128)) bytes.push((value % 128) | 128);
  return Uint8Array.from([...bytes, value]);
}
