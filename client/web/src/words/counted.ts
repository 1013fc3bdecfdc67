/** Counts in a sentence, in the form that a language has for them. */

/** Sentences by the plural forms of a language; "{n}" is the number. Forms that are left out are as `other`. */
export type Forms = Partial<Record<Intl.LDMLPluralRule, string>> & { readonly other: string };

/** Return the sentence about `count` things. */
export function counted(language: string, count: number, forms: Forms): string {
  const form = forms[new Intl.PluralRules(language).select(count)] ?? forms.other;
  return form.replace("{n}", new Intl.NumberFormat(language).format(count));
}
