/** Addresses of scripts of workers, which the build makes. */
declare module "*?worker&url" {
  const address: string;
  // biome-ignore lint/style/noDefaultExport: this is how the build hands it out.
  export default address;
}
