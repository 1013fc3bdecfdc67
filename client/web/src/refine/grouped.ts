/** Return elements in the order of their groups, and where each group begins; the last number is the end. */
export function grouped(groupOf: Uint16Array | Uint32Array, numGroups: number) {
  const first = new Uint32Array(numGroups + 1);
  for (const group of groupOf) first[group + 1]!++;
  for (let group = 0; group < numGroups; group++) first[group + 1]! += first[group]!;
  const next = first.slice();
  const order = new Uint32Array(groupOf.length);
  groupOf.forEach((group: number, element: number) => {
    order[next[group]!++] = element;
  });
  return { order, first };
}
