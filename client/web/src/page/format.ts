/** Numbers as people read them. */

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
  if (seconds < 90) return `${Math.max(Math.round(seconds / 5) * 5, 5)} seconds`;
  if (seconds < 90 * 60) return `${Math.round(seconds / 60)} minutes`;
  return `${Number((seconds / 3600).toFixed(1))} hours`;
}

/** Return a size in the largest unit that keeps it at or above one (1 MiB = 1048576 bytes). */
export function formatSize(sizeBytes: number): string {
  let size = sizeBytes;
  for (const unit of ["B", "KiB", "MiB"]) {
    if (size < 1024) return unit === "B" ? `${size} B` : `${size.toFixed(1)} ${unit}`;
    size /= 1024;
  }
  return `${size.toFixed(1)} GiB`;
}

/** Return an RFC 3339 time in the visitor's zone and language. */
export function formatTime(at: string): string {
  return new Date(at).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}

/** Return "1 file" or "3 files". */
export function plural(count: number, one: string, many = `${one}s`): string {
  return `${count} ${count === 1 ? one : many}`;
}
