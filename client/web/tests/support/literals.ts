/** Finds texts that people would read and that are in no catalogue. */

import { parseSync } from "vite";

/** A text, and the line it is on. */
export type Found = { readonly line: number; readonly text: string };

type Node = { readonly type: string; readonly start: number; readonly [key: string]: unknown };

const words = (text: string): string[] => text.trim().split(/\s+/);

/** Attributes and properties that are read out or shown; any letters in them are a text. */
const shownNames = new Set(
  words(`
    textContent innerText title placeholder alt text message legend ariaLabel ariaDescription ariaValueText
    ariaRoleDescription aria-label aria-description`),
);
/** Functions whose texts are shown, from this argument on; the first one of some is the name of an element. */
const showing = new Map([
  ...["h", "make"].map((name) => [name, 1] as const),
  ...["button", "section", "fold", "setText", "append", "replaceChildren"].map((name) => [name, 0] as const),
]);
/** Properties and attributes whose values are for the browser. */
const forBrowser = new Set(
  words(`
    class className style rel allow accept role type kind id for href tag sandbox cssText filter font name value step
    min max target loading autocomplete spellcheck method decoding unitDisplay format preload`),
);
/** Calls whose texts are for programs, or for programmers. */
const forPrograms = new Set(
  words(`
    querySelector querySelectorAll closest matches matchMedia setProperty getContext DOMException addEventListener set
    get has includes startsWith on`),
);
const twoWords = /\p{L}{2,}[,.;:!?]? \(?\p{L}/u;
const aWord = /\p{L}{2,}/u;

/** Return the texts in a module's source; `passed` are some that only programmers read. */
export function literalsIn(source: string, passed: ReadonlySet<string> = new Set()): Found[] {
  const found: Found[] = [];
  const { program, errors } = parseSync("module.ts", source);
  if (errors.length > 0) throw new Error(errors[0]!.message);
  const take = (node: Node, text: string, shown: boolean): void => {
    // Programs and style sheets, not sentences.
    const isCode = /[\n{}]|\\n|^<|\w\(|\)\.| = |; *$/.test(text);
    if (isCode || passed.has(text) || !(shown ? aWord : twoWords).test(text)) return;
    found.push({ line: source.slice(0, node.start).split("\n").length, text });
  };
  walk(program as unknown as Node, false, take);
  return found;
}

function walk(node: Node, shown: boolean, take: (node: Node, text: string, shown: boolean) => void): void {
  const into = (value: unknown, visible: boolean): void => {
    if (Array.isArray(value)) for (const each of value) into(each, visible);
    else if (isNode(value)) walk(value, visible, take);
  };
  const rest = (visible: boolean, ...skipped: string[]): void => {
    for (const [key, value] of Object.entries(node)) if (!skipped.includes(key)) into(value, visible);
  };
  switch (node.type) {
    case "ImportDeclaration":
    case "ImportExpression":
    case "ExportAllDeclaration":
      return;
    case "Literal":
      if (typeof node.value === "string") take(node, node.value, shown);
      return;
    case "TemplateLiteral": {
      const quasis = node.quasis as readonly { readonly value: { readonly raw: string } }[];
      take(node, quasis.map(({ value }) => value.raw).join("…"), shown);
      into(node.expressions, shown);
      return;
    }
    case "Property":
    case "PropertyDefinition": {
      const name = nameOf(node.key);
      if (!forBrowser.has(name)) into(node.value, shownNames.has(name));
      return;
    }
    case "AssignmentExpression": {
      const name = nameOf((node.left as Node).property ?? node.left);
      if (!forBrowser.has(name)) into(node.right, shownNames.has(name));
      return;
    }
    case "CallExpression":
    case "NewExpression": {
      const name = nameOf((node.callee as Node).property ?? node.callee);
      into(node.callee, false);
      if (forPrograms.has(name)) {
        // Listeners may say something.
        into(
          (node.arguments as readonly Node[]).filter(({ type }) => /Function/.test(type)),
          false,
        );
        return;
      }
      if (name === "setAttribute") {
        const [attribute, value] = node.arguments as readonly Node[];
        into(value, shownNames.has(String(attribute?.value)));
        return;
      }
      const first = showing.get(name);
      (node.arguments as readonly Node[]).forEach((given, index) => {
        if (first !== undefined && index < first) return;
        // The name of a parameter of an address.
        const isName = index === 0 && /^[a-z]+$/.test(String(given.value));
        if (name === "append" && isName && (node.arguments as unknown[]).length === 2) return;
        into(given, first !== undefined);
      });
      return;
    }
    case "BinaryExpression":
      // What is compared is a code; what is joined is a text.
      if (node.operator === "+") rest(shown);
      else rest(false);
      return;
    case "SwitchCase":
      into(node.consequent, false);
      return;
    case "MemberExpression":
      into(node.object, false);
      return;
    case "ConditionalExpression":
      into(node.test, false);
      into(node.consequent, shown);
      into(node.alternate, shown);
      return;
    case "ArrowFunctionExpression":
    case "FunctionExpression":
      rest(false, "params");
      return;
  }
  if (node.type.startsWith("TS") && !/^TS(As|Satisfies|NonNull)/.test(node.type)) return;
  rest(shown, "typeAnnotation", "returnType", "typeArguments", "typeParameters");
}

function isNode(value: unknown): value is Node {
  return typeof value === "object" && value !== null && typeof (value as Node).type === "string";
}

function nameOf(node: unknown): string {
  if (!isNode(node)) return "";
  return String(node.name ?? node.value ?? "");
}

/** Return the texts in the body and the title of a page that are not names of the catalogue (`%words.KEY%`). */
export function textsIn(html: string): string[] {
  const text = html
    .replace(/<!--.*?-->|<(script|style)\b.*?<\/\1>/gs, "")
    .replace(/<[^>]*>/g, "\n")
    .replace(/%words\.\w+%/g, "");
  const attributes = [...html.matchAll(/\b(?:title|alt|placeholder|aria-label)="([^"]+)"/g)].map(
    ([, value]) => value!,
  );
  return [...text.split("\n"), ...attributes].map((each) => each.trim()).filter((each) => aWord.test(each));
}
