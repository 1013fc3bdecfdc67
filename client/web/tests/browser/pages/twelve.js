// Adds as many elements as the address says, with the attributes that it gives.
const parameters = new URLSearchParams(location.search);
const main = document.querySelector("main");
main.classList.toggle("tall", parameters.has("tall"));
for (let index = 0; index < Number(parameters.get("count")); index++) {
  const element = document.createElement("lambent-viewer");
  element.setAttribute("alt", `Object ${index}`);
  for (const name of ["poster", "loading", "reveal", "controls"]) {
    const value = parameters.get(name);
    if (value !== null) element.setAttribute(name, value);
  }
  element.setAttribute(
    "state",
    parameters.get("state") ?? `env=preset:even&auto=0&ground=0&rotate=0,0,0&camera=30,20,3.2,0,0,0`,
  );
  const told = [];
  element.told = told;
  for (const event of ["progress", "load", "error", "camera-change", "light-change"]) {
    element.addEventListener(event, ({ detail }) => told.push([event, detail]));
  }
  element.setAttribute("src", parameters.get("src") ?? "/data/bundle/");
  main.append(element);
}
