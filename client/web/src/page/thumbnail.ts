/** Small pictures on cards, and what is drawn where there is none. */

import { h, svg } from "./dom.js";

/** Return a picture that can change; without an address, or where it cannot be loaded, a ball is drawn. */
export function thumbnail(): { element: HTMLElement; show: (url: string | null) => void } {
  // Its name is next to it; screen readers need not announce it twice.
  const image = h("img", { alt: "", decoding: "async", loading: "lazy", hidden: true });
  const drawn = ball();
  const element = h("span", { class: "thumbnail" }, image, drawn);
  const reveal = (has: boolean) => {
    image.hidden = !has;
    drawn.classList.toggle("covered", has);
  };
  image.addEventListener("load", () => reveal(true));
  image.addEventListener("error", () => reveal(false));
  return {
    element,
    show: (url) => {
      if (image.getAttribute("src") === url) return;
      if (url === null) {
        image.removeAttribute("src");
        reveal(false);
      } else {
        // Lazy pictures load when they are near the window, for which they must have a place.
        image.hidden = false;
        image.src = url;
      }
    },
  };
}

/** Return the picture at an address, or what is drawn without one. */
export function thumbnailOf(url: string | null): HTMLElement {
  const made = thumbnail();
  made.show(url);
  return made.element;
}

/** Return a lit ball as a drawing in the page's colours. */
function ball(): SVGElement {
  return svg(
    "svg",
    { viewBox: "0 0 40 30", "aria-hidden": "true" },
    svg("ellipse", { class: "shade", cx: 21, cy: 23.5, rx: 9, ry: 1.6 }),
    svg("ellipse", { class: "body", cx: 20, cy: 15, rx: 8, ry: 8 }),
    svg("ellipse", { class: "light", cx: 17.2, cy: 12.2, rx: 2.6, ry: 2.6 }),
  );
}
