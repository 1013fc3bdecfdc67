/** The page of scenes, jobs and bundles: one stream of events, and one view at a time. */

import { button, explain } from "../page/actions.js";
import { placeOf } from "../page/addresses.js";
import { h, setText } from "../page/dom.js";
import { removalNotices, Removals } from "../page/removals.js";
import { createApi, Refused } from "../page/rest.js";
import { noticeText, showAccount } from "./header.js";
import { createUploads } from "../upload/uploads.js";
import { jobView } from "./jobView.js";
import { failedSignIn, lockedView } from "./lockedView.js";
import { masksView } from "./masksView.js";
import { sceneView } from "./sceneView.js";
import { startView } from "./startView.js";
import { JobStore } from "./store.js";
import { follow } from "./stream.js";
import type { Context, View } from "./view.js";
import { speakAsBrowser, texts } from "../words/words.js";

await speakAsBrowser();
const api = createApi();
const store = new JobStore(api);
const message = document.querySelector<HTMLElement>("#message")!;
const connection = document.querySelector<HTMLElement>("#connection")!;
const main = document.querySelector<HTMLElement>("#main")!;
setText(connection, texts.connection.connecting);

const fail = (error: unknown): void => {
  if (error instanceof Refused && error.status === 401) {
    lock();
    return;
  }
  message.textContent = explain(error);
  message.hidden = false;
};
const removals = new Removals(fail);
const context: Context = { api, store, uploads: createUploads(api), removals, fail };

let shown: View | null = null;
let number = 0;
let isLocked = false;

/** Remove everything that this browser may not see or do (any more). */
function lock(): void {
  if (isLocked) return;
  isLocked = true;
  number += 1;
  setText(connection, texts.locked.status);
  logOut.remove();
  message.hidden = true;
  account.remove();
  put(lockedView(api, context.fail, () => location.reload(), failedSignIn(location.hash)));
}

async function show(): Promise<void> {
  if (isLocked) return;
  number += 1;
  const mine = number;
  message.hidden = true;
  const place = placeOf(location.hash);
  let view: View;
  try {
    if (place.kind === "scene") view = await sceneView(context, place.id);
    else if (place.kind === "masks") view = await masksView(context, place.id);
    else if (place.kind === "job") view = await jobView(context, place.id);
    else view = startView(context);
  } catch (error) {
    context.fail(error);
    view = { title: "Lambent", element: h("p", {}, h("a", { href: "#/" }, texts.start.allJobs)) };
  }
  // The visitor has opened another view meanwhile.
  if (mine !== number) {
    view.close?.();
    return;
  }
  put(view);
}

function put(view: View): void {
  const isFirst = shown === null;
  shown?.close?.();
  shown = view;
  main.replaceChildren(view.element);
  document.title = view.title === "Lambent" ? view.title : `${view.title} · Lambent`;
  if (isFirst) return;
  // Move the focus to the view that a link has opened.
  scrollTo(0, 0);
  main.querySelector<HTMLElement>("h1")?.focus();
}

/** Swap the code of a one-time link for a session, and take it out of the address. */
async function logIn(): Promise<void> {
  const code = new URLSearchParams(location.hash.slice(1)).get("code");
  if (code === null) return;
  history.replaceState(null, "", location.pathname);
  await api.logIn(code);
}

let wasAway = false;
const logOut = button(texts.locked.logOut, context, async () => {
  // What the page calls deleted must be deleted, which needs the session.
  await removals.flush();
  await api.logOut();
  location.reload();
});

const account = h("span", { class: "account" });

const notices = document.querySelector<HTMLElement>("#notices")!;

async function showNotices(): Promise<void> {
  const text = noticeText(await api.notices());
  notices.textContent = text;
  notices.hidden = text === "";
}

function showConnection(connected: boolean): void {
  if (isLocked) return;
  if (connected && !logOut.isConnected) {
    connection.after(account, logOut);
    showAccount(account, context, () => {
      location.hash = "#/";
      location.reload();
    }).catch(fail);
  }
  if (connected) showNotices().catch(fail);
  setText(connection, connected ? texts.connection.live : texts.connection.away);
  if (connected && wasAway) shown?.update?.(null);
  wasAway = !connected;
}

let pending = new Set<string>();

/** Draw at most once a frame, however many messages come. */
function changed(jobId: string): void {
  if (pending.size === 0) {
    requestAnimationFrame(() => {
      const now = pending;
      pending = new Set();
      for (const id of now) shown?.update?.(id);
    });
  }
  pending.add(jobId);
}

async function run(): Promise<void> {
  try {
    await logIn();
  } catch {
    // The link was used before; this browser may have been the one that used it.
  }
  store.listen(changed);
  main.after(removalNotices(removals));
  // Also when a phone suspends the page, which may never resume.
  addEventListener("pagehide", () => void removals.flush());
  addEventListener("hashchange", () => {
    // A login link was pasted while the page was open.
    if (location.hash.startsWith("#code=")) location.reload();
    else void show();
  });
  await show();
  await follow({
    api,
    onMessage: (one) => store.receive(one),
    onConnection: showConnection,
    signal: new AbortController().signal,
  });
}

run().catch((error) => {
  if (!isLocked) setText(connection, "");
  context.fail(error);
});
