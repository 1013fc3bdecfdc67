/** Only the element, for use in other pages: `<script type="module" src=".../lambent-viewer.js">`. */

import { defineViewer } from "./element.js";

defineViewer();
