/** Shown in place of the picture before there is one: an invitation, the progress of reading, or a problem. */

import { formatSize } from "../page/format.js";
import { make } from "./fields.js";
import { fillIn, texts } from "../words/words.js";

/** The panel over an empty picture. */
export class Welcome {
  readonly #heading = make("h1");
  readonly #text = make("p");
  readonly #progress = make("progress", { max: 1, ariaLabel: texts.viewer.reading });
  readonly #bytes = make("p", { className: "bytes" });
  readonly #again = make("button", { type: "button", textContent: texts.viewer.tryAgain });
  #retry: (() => void) | null = null;
  readonly element = make(
    "div",
    { className: "welcome" },
    this.#heading,
    this.#text,
    this.#progress,
    this.#bytes,
    make("div", { className: "row" }, this.#again),
  );

  constructor() {
    this.#again.addEventListener("click", () => this.#retry?.());
    this.invite();
  }

  invite(): void {
    this.#say(texts.viewer.invite, texts.viewer.inviteMore);
    this.#progress.hidden = true;
    this.#bytes.hidden = true;
  }

  reading(): void {
    this.#say(texts.viewer.opening, "");
    this.#progress.hidden = false;
    this.#progress.removeAttribute("value");
    // A line of its own from the start: nothing moves when the first bytes come.
    this.#bytes.hidden = false;
    this.#bytes.textContent = "\u00a0";
  }

  /** The bundle that is read has a name. */
  named(name: string): void {
    this.#heading.textContent = name;
  }

  /** Show how much has come, in bytes. */
  arrived(readBytes: number, totalBytes: number): void {
    this.#progress.value = readBytes / Math.max(totalBytes, 1);
    this.#bytes.hidden = false;
    this.#bytes.textContent = fillIn(texts.page.of, {
      part: formatSize(readBytes),
      whole: formatSize(totalBytes),
    });
  }

  /** The bundle cannot be shown; `retry` asks for it again. */
  failed(retry: (() => void) | null): void {
    // The message says what went wrong; screen readers announce it.
    this.#say(texts.viewer.notShown, "");
    this.#retry = retry;
    this.#again.hidden = retry === null;
    this.#progress.hidden = true;
    this.#bytes.hidden = true;
  }

  #say(heading: string, text: string): void {
    this.#heading.textContent = heading;
    this.#text.textContent = text;
    this.#text.hidden = text === "";
    this.#again.hidden = true;
    this.#retry = null;
  }
}
