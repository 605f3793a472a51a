// The axes of the world in the corner of a view: how its camera is turned, and buttons that look along each axis.
import * as geometry from "./geometry.js";
import { make } from "./state.js";

/** Pixels from the middle to the ends of axes that lie in the image. */
const REACH_PX = 32;
const NAMES = ["x", "y", "z"];
const SVG = "http://www.w3.org/2000/svg";

/** Axes [name, direction]; those that point the other way have a minus sign. */
const ENDS = NAMES.flatMap((name, axis) =>
  [1, -1].map((sign) => {
    const direction = [0, 0, 0];
    direction[axis] = sign;
    return [sign > 0 ? name : `−${name}`, direction];
  }),
);

/** The element, and `turn`, which shows the axes as a camera of a rotation sees them. `pressed` is called with the axis that is chosen. */
export function makeAxes(pressed) {
  const lines = document.createElementNS(SVG, "svg");
  lines.setAttribute("aria-hidden", "true");
  const size = 2 * REACH_PX;
  lines.setAttribute("viewBox", `${-REACH_PX} ${-REACH_PX} ${size} ${size}`);
  const ends = ENDS.map(([name, direction]) => {
    const isPositive = direction.some((value) => value > 0);
    const button = make("button", { className: `end ${name.at(-1)}`, textContent: isPositive ? name.toUpperCase() : "" });
    button.classList.toggle("negative", !isPositive);
    button.title = `Look from ${name.toUpperCase()}`;
    button.setAttribute("aria-label", button.title);
    button.onclick = () => pressed(direction);
    const line = isPositive ? document.createElementNS(SVG, "line") : null;
    if (line) {
      line.setAttribute("class", name);
      lines.append(line);
    }
    return { button, direction, line };
  });
  const element = make("div", { className: "axes" }, lines, ...ends.map(({ button }) => button));
  element.setAttribute("role", "group");
  element.setAttribute("aria-label", "Axes");
  // A press here neither turns the camera nor chooses a place.
  ["pointerdown", "dblclick"].forEach((kind) => element.addEventListener(kind, (event) => event.stopPropagation()));
  const turn = (rotation) => {
    const at = { position_m: [0, 0, 0], rotation };
    ends.forEach(({ button, direction, line }) => {
      const [right, down, away] = geometry.toLocal(at, direction);
      const [x, y] = [REACH_PX * right, REACH_PX * down];
      button.style.translate = `${x}px ${y}px`;
      // The nearest covers the others.
      button.style.zIndex = Math.round(10 - 9 * away);
      line?.setAttribute("x2", x);
      line?.setAttribute("y2", y);
    });
  };
  return { element, turn };
}
