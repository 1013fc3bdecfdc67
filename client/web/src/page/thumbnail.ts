/** Small pictures on cards, and what is drawn where there is none. */

import { h } from "./dom.js";

const svgSpace = "http://www.w3.org/2000/svg";

/** Return a picture that can change; without an address, or where it cannot be loaded, a ball is drawn. */
export function thumbnail(): { element: HTMLElement; show: (url: string | null) => void } {
  // Its name is next to it; screen readers need not announce it twice.
  const image = h("img", { alt: "", decoding: "async", loading: "lazy", hidden: true });
  const drawn = ball();
  const element = h("span", { class: "thumbnail" }, image, drawn as unknown as HTMLElement);
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
  const picture = document.createElementNS(svgSpace, "svg");
  picture.setAttribute("viewBox", "0 0 40 30");
  picture.setAttribute("aria-hidden", "true");
  const parts: [string, string, number, number, number, number][] = [
    ["ellipse", "shade", 21, 23.5, 9, 1.6],
    ["ellipse", "body", 20, 15, 8, 8],
    ["ellipse", "light", 17.2, 12.2, 2.6, 2.6],
  ];
  for (const [name, part, cx, cy, rx, ry] of parts) {
    const shape = document.createElementNS(svgSpace, name);
    shape.setAttribute("class", part);
    for (const [key, value] of Object.entries({ cx, cy, rx, ry })) shape.setAttribute(key, String(value));
    picture.append(shape);
  }
  return picture;
}
