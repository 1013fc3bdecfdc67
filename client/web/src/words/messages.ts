/** Messages with places for values, such as "{name} was deleted." */

import { language } from "./languages.js";

/** A message by the plural forms of a language for the number `n`; forms that are left out are as `other`. */
export type Forms = Partial<Record<Intl.LDMLPluralRule, string>> & { readonly other: string };

/** What is wrong, and what to do about it. */
export type Problem = { readonly what: string; readonly advice: string };

type Values = Readonly<Record<string, string | number>>;

/** Return a message with values in its places; `npm test` compares their names with those of the message. */
export function fillIn(message: string | Forms, values: Values): string;
export function fillIn(message: Problem, values: Values): Problem;
export function fillIn(message: string | Forms | Problem, values: Values): string | Problem {
  if (typeof message === "string") return message.replace(/\{(\w+)\}/g, (_, name) => String(values[name]));
  if ("what" in message)
    return { what: fillIn(message.what, values), advice: fillIn(message.advice, values) };
  const count = Number(values.n);
  const form = message[new Intl.PluralRules(language).select(count)] ?? message.other;
  return fillIn(form, { ...values, n: new Intl.NumberFormat(language).format(count) });
}
