// Commanded compliance: a slider for each robot, over the range of its policy.

import { fixed } from "./numbers.js";

/** The compliance for a slider position: far left the policy's own (null), elsewhere the nearest within the range. */
const meaning = (value, [low, high]) => (value < low / 2 ? null : Math.min(Math.max(value, low), high));

const inWords = (compliance, own) => (compliance !== null ? compliance.toFixed(3) : `own, ${own.map(fixed(3)).join(" ")}`);

/** Shows a slider for each robot; calls `tell(robot, compliance)` when one is released. */
export function show(list, robots, tell) {
  const names = robots.map(({ name }) => name).join("\n");
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    list.replaceChildren(...robots.map(({ name }) => row(name)));
  }
  robots.forEach(({ compliance, reach }, robot) => {
    const [slider, said] = list.children[robot].querySelectorAll("input, output");
    slider.disabled = !reach;
    if (!reach) {
      said.textContent = "not calibrated: run policy calibrate";
      return;
    }
    const [range, own] = reach;
    slider.max = range[1];
    slider.oninput = () => (said.textContent = inWords(meaning(slider.valueAsNumber, range), own));
    slider.onchange = () => tell(robot, meaning(slider.valueAsNumber, range));
    if (slider.matches(":active, :focus")) return;
    slider.value = compliance ?? 0;
    said.textContent = inWords(compliance, own);
  });
}

function row(name) {
  const label = document.createElement("label");
  const of = (kind, more) => Object.assign(document.createElement(kind), more);
  const slider = of("input", { type: "range", min: 0, step: 0.001, value: 0 });
  // Give the keys back to walking.
  slider.onpointerup = () => slider.blur();
  label.append(of("span", { textContent: name }), slider, of("output"));
  return label;
}
