export function scriptBytes(pages: string): Record<string, number>;
