/** Files of GLSL, as the build reads them. */
declare module "*.glsl?raw" {
  const text: string;
  // biome-ignore lint/style/noDefaultExport: this is how the build hands it out.
  export default text;
}
