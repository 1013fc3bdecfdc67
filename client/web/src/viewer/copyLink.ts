/** Copies a link to what is shown, and says what it cannot carry. */

import type { Api } from "../page/rest.js";
import { formatList } from "../page/format.js";
import { button, make } from "./fields.js";
import { linkOf, missingOf } from "./links.js";
import type { ViewerState } from "./state.js";
import type { Viewer } from "./viewer.js";
import { fillIn, texts } from "../words/words.js";

export type CopyHost = {
  readonly viewer: Viewer;
  /** Where a dialog is put. */
  readonly root: ShadowRoot;
  readonly tell: (text: string, problem: boolean) => void;
  /** Whether the page is the viewer's own. */
  readonly full: boolean;
};

const mostName = 100;

/** Copy the link; where a map on this computer could be uploaded for it, ask first. */
export async function copyLink(host: CopyHost): Promise<void> {
  const { viewer } = host;
  const missing = missingOf(viewer);
  if (missing.maps.length > 0 && !missing.bundle && viewer.serverBundle !== null) {
    askToUpload(host, missing.maps);
    return;
  }
  await copy(host);
}

/** Return a sentence about what a link leaves out, or "". */
export function missingText({ bundle, maps }: ReturnType<typeof missingOf>): string {
  const parts = [...(bundle ? [texts.link.object] : []), ...maps];
  if (parts.length === 0) return "";
  return fillIn(texts.link.lacks, { n: parts.length, what: formatList(parts) });
}

async function copy({ viewer, tell, full }: CopyHost): Promise<void> {
  const link = linkOf(viewer, location.href, full);
  const lacks = missingText(missingOf(viewer));
  try {
    await navigator.clipboard.writeText(link);
    tell(`${texts.link.copied} ${lacks}`.trim(), false);
  } catch {
    tell(`${link} ${lacks}`.trim(), false);
  }
}

function askToUpload(host: CopyHost, maps: readonly string[]): void {
  const news = make("p", { className: "hint", role: "alert" });
  const parts = [
    missingText({ bundle: false, maps }),
    fillIn(texts.link.ask, { n: maps.length }),
    texts.link.askMore,
  ];
  const upload = button(texts.link.upload, () => {
    upload.disabled = true;
    news.textContent = texts.link.uploading;
    uploadMaps(host.viewer, maps)
      .then(async () => {
        dialog.close();
        await copy(host);
      })
      .catch(async (error: unknown) => {
        const { explain } = await import("../page/actions.js");
        news.textContent = explain(error);
        upload.disabled = false;
      });
  });
  const without = button(texts.link.without, () => {
    dialog.close();
    void copy(host);
  });
  const dialog = make(
    "dialog",
    { className: "ask", ariaLabel: texts.link.title },
    make("h2", { textContent: texts.link.title }),
    make("p", { textContent: parts.join(" ") }),
    news,
    make("div", { className: "buttons" }, upload, without),
    button(texts.page.cancel, () => dialog.close()),
  );
  dialog.addEventListener("close", () => dialog.remove());
  host.root.append(dialog);
  dialog.showModal();
}

/** Upload maps and light the object with what is on the server then. */
async function uploadMaps(viewer: Viewer, maps: readonly string[]): Promise<void> {
  const { createApi } = await import("../page/rest.js");
  const api = createApi();
  const found = new Map<string, string>();
  for (const name of maps) found.set(`file:${name}`, await uploadMap(api, name, viewer.lights.file(name)!));
  const { environment, environmentB } = viewer.state;
  const change: Partial<ViewerState> = {
    environment: found.get(environment) ?? environment,
    environmentB: found.get(environmentB) ?? environmentB,
  };
  await viewer.update(change);
}

/** Upload one map; returns its light, which is called as the file was. */
export async function uploadMap(
  api: Pick<Api, "createEnvironment">,
  name: string,
  data: Uint8Array<ArrayBuffer>,
): Promise<string> {
  // biome-ignore lint/suspicious/noControlCharactersInRegex: the server refuses them
  const plain = name.replace(/[\x00-\x1f\x7f]/g, " ").slice(0, mostName) || "map";
  const { url } = await api.createEnvironment(plain, new Blob([data]));
  return `url:${url}#${encodeURIComponent(plain)}`;
}
