/** The look of the viewer; a constructed sheet, so that a strict content security policy lets it pass. */

const text = `
:host { display: block; position: relative; min-height: 12rem; background: #17191c; color: #f2f3f5;
  font: 0.9rem/1.4 system-ui, sans-serif; overflow: hidden; container-type: size; color-scheme: dark; }
* { box-sizing: border-box; }
.view { position: absolute; inset: 0; }
canvas { position: absolute; inset: 0; width: 100%; height: 100%; touch-action: pan-y !important; cursor: grab; display: block; }
:host([fullpage]) canvas { touch-action: none !important; }
canvas:active { cursor: grabbing; }
:host([data-background=transparent]:not([fullpage])) { background: none; }
:host([data-background=transparent]:not([fullpage])) .welcome { background: #17191c; }
:host([fullpage][data-background=transparent]) canvas { background: repeating-conic-gradient(#26292d 0 25%, #1d2023 0 50%) 0 0 / 24px 24px; }
:focus-visible { outline: 3px solid #8ec7ff; outline-offset: 2px; }
canvas:focus-visible { outline-offset: -4px; }
.panel { position: absolute; top: 0.75rem; right: 0.75rem; width: 22rem; max-height: calc(100% - 1.5rem); overflow: auto;
  background: rgb(24 27 31 / 94%); border: 1px solid #4b525b; border-radius: 0.6rem; padding: 0.25rem 0.75rem; }
.panel > summary { padding: 0.4rem 0; font-weight: 600; cursor: pointer; }
.panel details > summary { cursor: pointer; padding: 0.35rem 0; color: #dfe4ea; }
.panel details { border-top: 1px solid #3a4048; }
.fields { display: grid; gap: 0.45rem; padding-bottom: 0.6rem; }
label, .row { display: grid; grid-template-columns: 7rem 1fr; align-items: center; gap: 0.5rem; }
label.check { grid-template-columns: 1.2rem 1fr; }
.slide { display: grid; grid-template-columns: 1fr 4.4rem; gap: 0.4rem; }
input, select, button { font: inherit; color: inherit; background: #2a2f36; border: 1px solid #6b7480; border-radius: 0.35rem;
  min-height: 1.9rem; padding: 0 0.45rem; width: 100%; min-width: 0; }
input[type=range] { padding: 0; accent-color: #8ec7ff; background: none; border: 0; }
input[type=checkbox] { min-height: 1.2rem; width: 1.2rem; accent-color: #8ec7ff; }
input[type=color] { padding: 0.1rem; }
button { cursor: pointer; }
button:hover { background: #394049; }
.buttons { display: grid; grid-template-columns: 1fr 1fr; gap: 0.45rem; }
.poster { position: absolute; inset: 0; display: grid; place-items: center; }
.poster > img, .poster > canvas { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: contain; cursor: auto; background: none !important; }
.poster > button { position: relative; width: auto; min-height: 2.75rem; padding: 0 1.2rem; background: rgb(24 27 31 / 94%); }
.poster:not([hidden], [data-asks]) ~ .welcome { background: none !important; align-content: end; }
.poster:not([hidden], [data-asks]) ~ .welcome > :not(progress) { display: none; }
.message { position: absolute; left: 0.75rem; bottom: 0.75rem; max-width: min(34rem, calc(100% - 1.5rem)); padding: 0.5rem 0.8rem;
  border-radius: 0.4rem; background: rgb(24 27 31 / 94%); border: 1px solid #4b525b; overflow-wrap: anywhere; }
.message:empty { display: none; }
.message[data-problem] { border-color: #ff9b8f; border-left-width: 6px; }
.welcome { position: absolute; inset: 0; display: grid; place-content: center; text-align: center; padding: 1rem; gap: 0.6rem; }
.welcome h1 { font-size: 1.3rem; margin: 0; }
.welcome p { margin: 0; max-width: 32rem; }
.welcome .bytes { font-variant-numeric: tabular-nums; opacity: 0.8; }
.welcome .row { display: block; }
.welcome button { min-height: 2.75rem; padding: 0 1.2rem; }
progress { width: min(20rem, 70cqw); justify-self: center; accent-color: #8ec7ff; }
.dropping::after { content: attr(data-drop); position: absolute; inset: 0.5rem; display: grid;
  place-content: center; border: 3px dashed #8ec7ff; border-radius: 0.8rem; background: rgb(23 25 28 / 80%); pointer-events: none; }
.split { position: absolute; top: 0; bottom: 0; width: 0; left: 50%; pointer-events: none; }
.split::before { content: ""; position: absolute; top: 0; bottom: 0; left: -1px; width: 2px; background: #fff; box-shadow: 0 0 3px #000; }
.handle { position: absolute; top: 50%; left: -1.4rem; width: 2.8rem; height: 2.8rem; margin-top: -1.4rem; border-radius: 50%;
  background: #17191c; border: 2px solid #fff; pointer-events: auto; touch-action: none; cursor: ew-resize; display: grid; place-content: center; }
.sides { position: absolute; top: 4rem; left: 0.75rem; right: 0.75rem; display: flex; justify-content: space-between; gap: 0.5rem; pointer-events: none; }
.sides span { background: rgb(24 27 31 / 94%); border-radius: 0.3rem; padding: 0.15rem 0.5rem; }
.tools { position: absolute; top: 0.75rem; left: 0.75rem; display: flex; gap: 0.35rem; }
.tools button { width: 2.75rem; min-height: 2.75rem; padding: 0; font-size: 1.25rem; background: rgb(24 27 31 / 94%); border-color: #4b525b; }
.tools [aria-disabled=true] { color: #8d96a1; cursor: default; }
.dock { display: contents; }
.strip { position: absolute; left: 0.75rem; right: 0.75rem; bottom: 0.75rem; display: grid; gap: 0.4rem; pointer-events: none; }
.line { display: flex; align-items: center; gap: 0.6rem; min-width: 0; }
.line > *, .adding { pointer-events: auto; }
.chips { display: flex; gap: 0.4rem; overflow-x: auto; min-width: 0; margin-right: auto; padding: 0.3rem; scrollbar-width: thin;
  background: rgb(24 27 31 / 88%); border: 1px solid #4b525b; border-radius: 0.8rem; overscroll-behavior-x: contain; }
.chip { flex: none; width: 6rem; display: grid; justify-items: center; align-content: start; gap: 0.15rem; padding: 0.3rem 0.2rem;
  background: none; border-color: transparent; border-radius: 0.6rem; font-size: 0.72rem; line-height: 1.2; }
.chip canvas { position: static; width: 3rem; height: 3rem; pointer-events: none; border-radius: 50%; background: #3a4048; }
.chip span { max-width: 100%; overflow: hidden; display: -webkit-box; -webkit-line-clamp: 2; -webkit-box-orient: vertical; overflow-wrap: anywhere; }
.chip[aria-pressed=true] { border-color: #8ec7ff; background: #22384d; }
.chip .plus { display: grid; place-content: center; width: 3rem; height: 3rem; border-radius: 50%; border: 2px dashed #7b858f; font-size: 1.4rem; }
.adding { display: grid; gap: 0.45rem; width: min(22rem, 100%); padding: 0.7rem; background: rgb(24 27 31 / 96%); border: 1px solid #4b525b; border-radius: 0.6rem; }
.ball { flex: none; position: relative; width: 4.5rem; height: 4.5rem; border-radius: 50%; border: 2px solid #dfe4ea; background-color: #2a2f36;
  cursor: grab; touch-action: none; box-shadow: 0 0 0 1px #17191c; }
.ball:active { cursor: grabbing; }
.ball .dot { position: absolute; width: 0.8rem; height: 0.8rem; margin: -0.4rem; border-radius: 50%; background: #ffd873; border: 2px solid #17191c; }
.ball.behind .dot { background: #17191c; border-color: #ffd873; }
.photo { position: absolute; object-fit: fill; pointer-events: none; }
.ask { width: min(26rem, calc(100% - 2rem)); color: #f2f3f5; background: #181b1f; border: 1px solid #4b525b; border-radius: 0.6rem; padding: 1rem; }
.ask::backdrop { background: rgb(0 0 0 / 60%); }
.ask h2 { font-size: 1.1rem; margin: 0; }
.ask .buttons { margin: 0.6rem 0 0.45rem; }
.fields h3 { font-size: 1rem; margin: 0; }
.hint, .faint { color: #c3cad3; font-size: 0.82rem; margin: 0; }
.hint:empty, .faint:empty { display: none; }
.actions { display: grid; grid-template-columns: auto 1fr; gap: 0.45rem; align-items: center; }
.actions label { display: contents; }
.actions button { grid-column: 1 / -1; }
#share { display: grid; gap: 0.45rem; }
#sites { grid-column: 1 / -1; }
.shares { list-style: none; margin: 0; padding: 0; display: grid; gap: 0.6rem; }
.shares li { display: grid; grid-template-columns: 1fr 1fr; gap: 0.4rem; }
.shares li > input, .shares li > span { grid-column: 1 / -1; }
[hidden] { display: none !important; }
.message:has(~ .dock:not([hidden]) > .strip:not([hidden])) { bottom: 8rem; }
@container (min-width: 40rem) {
  /* The longest choices are German ones. */
  .panel label:has(> select) { grid-template-columns: 6.1rem 1fr; }
  /* Also while the panel is not shown yet: nothing shifts when a bundle begins to load. */
  .view:has(~ .dock > .panel[open]), .welcome:has(~ .dock > .panel[open]) { right: 23.5rem; }
  .dock:has(> .panel[open]) > .strip { right: 24.25rem; }
}
@container (max-width: 40rem) {
  .dock:not([hidden]) { position: absolute; left: 0; right: 0; bottom: 0; display: flex; flex-direction: column; }
  .strip { position: static; padding: 0 0.5rem 0.4rem; }
  .panel { position: static; width: auto; max-height: 45cqh; padding: 0 0.75rem; border-radius: 0.8rem 0.8rem 0 0; overscroll-behavior: contain; }
  .panel > summary { position: sticky; top: 0; z-index: 1; margin: 0 -0.75rem; padding: 0.75rem; background: #181b1f; touch-action: none; }
  .panel > summary::before { content: ""; position: absolute; top: 0.35rem; left: calc(50% - 1.2rem); width: 2.4rem; height: 0.25rem; border-radius: 1rem; background: #7b858f; }
  .message:has(~ .dock:not([hidden]) > .strip:not([hidden])) { bottom: 11rem; }
  /* In the middle of what the open sheet leaves. */
  .view:has(~ .dock > .panel[open]) .handle { top: 22cqh; }
  label, .row { grid-template-columns: 7.5rem 1fr; }
}
/* Fingers need more room than pointers. */
@media (pointer: coarse) {
  input, select, button, label.check, .panel summary { min-height: 2.75rem; }
  .panel details > summary { padding: 0.75rem 0; }
  input[type=checkbox] { min-height: 1.5rem; width: 1.5rem; }
  label.check { grid-template-columns: 1.5rem 1fr; }
}
@media (prefers-reduced-motion: no-preference) { .panel { transition: opacity 0.15s; } }
`;

export function viewerSheet(): CSSStyleSheet {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(text);
  return sheet;
}
