/** The look of the dialogs, which are loaded when they are opened. */

const style = `
.work { width: min(30rem, calc(100% - 2rem)); max-height: calc(100% - 2rem); overflow: auto; color: #f2f3f5; background: #181b1f;
  border: 1px solid #4b525b; border-radius: 0.6rem; padding: 1rem; }
.work::backdrop { background: rgb(0 0 0 / 60%); }
.work h2 { font-size: 1.1rem; margin: 0 0 0.6rem; }
.work fieldset { border: 0; margin: 0; padding: 0; }
.work form { display: grid; gap: 0.45rem; }
.work canvas { position: static; inset: auto; width: 100%; height: auto; max-height: 14rem; object-fit: contain; cursor: auto; touch-action: auto;
  background: #101214; border-radius: 0.35rem; }
.work progress { width: 100%; }
.work .problem { color: #ffb4ab; }
`;

let sheet: CSSStyleSheet | null = null;

/** Return the sheet. */
export function dialogSheet(): CSSStyleSheet {
  if (sheet === null) {
    sheet = new CSSStyleSheet();
    sheet.replaceSync(style);
  }
  return sheet;
}
