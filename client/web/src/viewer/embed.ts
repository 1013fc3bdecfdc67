/** Only the element, for use in other pages: `<script type="module" src=".../lambent-viewer.js">`. */

import { defineViewer } from "./element.js";
import { isFetched } from "../words/languages.js";
import { languageOfPage, speak } from "../words/words.js";

// The element draws its controls as soon as it is known, and by then in its language.
const language = languageOfPage("lambent-viewer");
if (isFetched(language)) await speak(language);
else void speak(language);
defineViewer();
