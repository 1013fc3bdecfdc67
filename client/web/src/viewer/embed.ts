/** The element alone, for other people's pages: `<script type="module" src=".../lambent-viewer.js">`. */

import { defineViewer } from "./element.js";

defineViewer();
