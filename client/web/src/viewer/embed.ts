/** Only the element, for use in other pages: `<script type="module" src=".../lambent-viewer.js">`. */

import { defineViewer } from "./element.js";
import { speakAsPage } from "../words/words.js";

// The element draws its controls as soon as it is known, and by then in its language.
await speakAsPage("lambent-viewer");
defineViewer();
