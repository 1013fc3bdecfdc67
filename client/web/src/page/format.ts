/** Numbers as people read them, in the language of the page. */

import { locale } from "../words/words.js";

/** Return a number with `digits` decimals. */
export function formatNumber(value: number, digits = 0): string {
  const limits = { minimumFractionDigits: digits, maximumFractionDigits: digits };
  return new Intl.NumberFormat(locale, limits).format(value);
}

/** Return a share of one as whole percent. */
export function formatPercent(share: number): string {
  return new Intl.NumberFormat(locale, { style: "percent" }).format(share);
}

/** Return seconds as "m:ss" or "h:mm:ss". */
export function formatDuration(seconds: number): string {
  const whole = Math.max(Math.round(seconds), 0);
  const hours = Math.floor(whole / 3600);
  const minutes = Math.floor(whole / 60) % 60;
  const rest = String(whole % 60).padStart(2, "0");
  return hours > 0 ? `${hours}:${String(minutes).padStart(2, "0")}:${rest}` : `${minutes}:${rest}`;
}

/** Return seconds in words that promise no more than an estimate can: "45 seconds", "6 minutes", "2.5 hours". */
export function formatAbout(seconds: number): string {
  const told = (value: number, unit: string, digits = 0): string =>
    new Intl.NumberFormat(locale, {
      style: "unit",
      unit,
      unitDisplay: "long",
      maximumFractionDigits: digits,
    }).format(value);
  if (seconds < 90) return told(Math.max(Math.round(seconds / 5) * 5, 5), "second");
  if (seconds < 90 * 60) return told(seconds / 60, "minute");
  return told(seconds / 3600, "hour", 1);
}

/** Return a size in the largest unit that keeps it at or above one (1 MiB = 1048576 bytes). */
export function formatSize(sizeBytes: number): string {
  let size = sizeBytes;
  for (const unit of ["B", "KiB", "MiB"]) {
    if (size < 1024) return `${formatNumber(size, unit === "B" ? 0 : 1)} ${unit}`;
    size /= 1024;
  }
  return `${formatNumber(size, 1)} GiB`;
}

/** Return an RFC 3339 time in the visitor's zone. */
export function formatTime(at: string): string {
  return new Date(at).toLocaleString(locale, { dateStyle: "medium", timeStyle: "short" });
}

/** Return names as a list in a sentence: "a, b, and c". */
export function formatList(names: readonly string[]): string {
  return new Intl.ListFormat(locale, { type: "conjunction" }).format(names);
}
