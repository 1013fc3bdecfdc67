/** Compares what modules fill into messages of the catalogues with the places that those have. */

import { parseSync } from "vite";
import english from "../../src/words/en.json";

type Node = { readonly type: string; readonly start: number; readonly [key: string]: unknown };

/** Return the names of the places in a message, or in any message of a part of a catalogue. */
export function placesOf(message: unknown): Set<string> {
  if (typeof message === "string")
    return new Set([...message.matchAll(/\{(\w+)\}/g)].map(([, name]) => name!));
  const parts = Object.entries(message as object);
  const places = new Set(parts.flatMap(([, part]) => [...placesOf(part)]));
  return parts.some(([name]) => name === "other") ? places.add("n") : places;
}

/** Return what is wrong in a module's source: messages with places that are not filled, or with other values. */
export function misfilled(source: string): string[] {
  const found: string[] = [];
  const { program } = parseSync("module.ts", source);
  /** The texts that a chain of properties leads to: `texts.page.undo`; undefined for anything else. */
  const meant = (node: Node): unknown => {
    if (node.type === "Identifier") return (english as Record<string, unknown>)[String(node.name)];
    if (node.type !== "MemberExpression") return undefined;
    const whole = meant(node.object as Node) as Record<string, unknown> | undefined;
    return node.computed ? whole : whole?.[String((node.property as Node).name)];
  };
  const walk = (node: Node, taken: Set<string> | null): void => {
    const text = node.type === "MemberExpression" ? meant(node) : undefined;
    if (text !== undefined) {
      const places = placesOf(text);
      for (const name of places) taken?.add(name);
      if (taken === null && places.size > 0) found.push(source.slice(node.start, node.end as number));
      if (node.computed) walk(node.property as Node, null);
      return;
    }
    if (node.type === "CallExpression" && (node.callee as Node).name === "fillIn") {
      const [message, values] = node.arguments as readonly [Node, Node];
      const places = new Set<string>();
      walk(message, places);
      const names =
        (values.properties as readonly Node[] | undefined)?.map(({ key }) => String((key as Node)?.name)) ??
        [];
      if (String([...places].sort()) !== String(names.sort())) {
        found.push(source.slice(node.start, node.end as number));
      }
      walk(values, null);
      return;
    }
    for (const part of Object.values(node).flat()) {
      if (typeof part === "object" && typeof (part as Node | null)?.type === "string")
        walk(part as Node, taken);
    }
  };
  walk(program as unknown as Node, null);
  return found;
}
