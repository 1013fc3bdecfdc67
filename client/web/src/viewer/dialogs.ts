/** The look of the dialogs, which are loaded when they are opened, and how they tell of their work. */

import { make } from "./fields.js";

const style = `
.work { width: min(30rem, calc(100% - 2rem)); max-height: calc(100% - 2rem); overflow: auto; color: #f2f3f5; background: #181b1f;
  border: 1px solid #4b525b; border-radius: 0.6rem; padding: 1rem; }
.work::backdrop { background: rgb(0 0 0 / 60%); }
.work[open] { display: grid; gap: 0.6rem; }
.work h2 { font-size: 1.1rem; margin: 0; }
.work fieldset { border: 0; margin: 0; padding: 0; }
.work form { display: grid; gap: 0.45rem; }
.work canvas { position: static; inset: auto; width: 100%; height: auto; max-height: 14rem; object-fit: contain; cursor: auto; touch-action: auto;
  background: #101214; border-radius: 0.35rem; }
.work progress { width: 100%; }
.work .problem { color: #ffb4ab; }
`;

let sheet: CSSStyleSheet | null = null;

export function dialogSheet(): CSSStyleSheet {
  if (sheet === null) {
    sheet = new CSSStyleSheet();
    sheet.replaceSync(style);
  }
  return sheet;
}

/**
 * Two lines that tell how far work is: `count`, which may change with every frame, and `news`, which is read out to those who do
 * not see it and therefore only has the quarters of the work, its beginning and its end.
 */
export class WorkNews {
  readonly count = make("p", { className: "hint" });
  readonly news = make("p", { className: "hint", role: "status" });
  #quarters = 0;

  /** Say something else than how far it is. */
  say(text: string, problem = false): void {
    this.#quarters = 0;
    this.count.textContent = "";
    this.news.textContent = text;
    this.news.classList.toggle("problem", problem);
  }

  /** Say how far it is: a share of all, and a text. */
  reach(share: number, text: string): void {
    this.count.textContent = text;
    const quarters = Math.floor(4 * share);
    if (quarters > this.#quarters) {
      this.#quarters = quarters;
      this.news.textContent = `${25 * quarters} %`;
      // What was said before it began is no longer true.
    } else if (quarters === 0) this.news.textContent = "";
  }
}
