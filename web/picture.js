// The picture: the robots' views side by side, drawn as finely as the machine can.

import * as THREE from "./three.module.min.js";
import { listenToHand } from "./hand.js";
import { IS_SOFTWARE } from "./shapes.js";
import { View } from "./view.js";

const TINTS = [0x0072b2, 0xe69f00];
/** Frame rate below which the picture becomes coarser, the rates of pixels that are tried, and the fewest pixels. */
const [SLOW_HZ, FINENESS, FEWEST] = [50, [1, 0.75, 0.5, 0.35], 1.5e5];
/** Field of view of a view that is higher than wide, across, and of others, upright [rad]. */
const [ACROSS_RAD, UPRIGHT_RAD] = [0.56, 0.61];

/** Draws robots into an element; `on` are the calls of listenToHand. */
export class Picture {
  constructor(place, on) {
    Object.assign(this, { place, views: [], fineness: IS_SOFTWARE ? 1 : 0, frames: 0, since: performance.now(), last: 0, rate: null });
    this.orbit = { around: -2.25, above: 0.5, away: 2.2 };
    this.renderer = new THREE.WebGLRenderer({ antialias: !IS_SOFTWARE, stencil: true, powerPreference: "high-performance" });
    this.renderer.setScissorTest(true);
    place.append(this.renderer.domElement);
    new ResizeObserver(() => this.resize()).observe(place);
    listenToHand(this, on);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint());
    requestAnimationFrame((time) => this.draw(time));
  }

  /** Begins with other robots: their drawn parts. */
  begin(parts) {
    this.views.forEach(({ scene }) => scene.traverse(({ geometry }) => geometry?.dispose()));
    this.views = parts.map((own, index) => new View(own, TINTS[index]));
    this.paint();
    this.resize();
  }

  paint() {
    // A colour of the style sheet, as it is in the present scheme.
    const colour = (name) => {
      this.place.style.color = `var(--${name})`;
      return getComputedStyle(this.place).color;
    };
    const colours = Object.fromEntries(["sky", "square", "other", "grid"].map((name) => [name, colour(name)]));
    this.views.forEach((view) => view.paint(colours));
  }

  resize() {
    const { clientWidth, clientHeight } = this.place;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * FINENESS[this.fineness]);
    this.renderer.setSize(clientWidth, clientHeight);
    const width = clientWidth / Math.max(1, this.views.length);
    this.areas = this.views.map((_, index) => [index * width, 0, width, clientHeight]);
    for (const { camera } of this.views) {
      camera.aspect = width / clientHeight;
      const upright = camera.aspect < 1 ? Math.min(1.05, 2 * Math.atan(Math.tan(ACROSS_RAD / 2) / camera.aspect)) : UPRIGHT_RAD;
      camera.fov = THREE.MathUtils.radToDeg(upright);
      camera.updateProjectionMatrix();
    }
  }

  show(robots) {
    robots.forEach((robot, index) => this.views[index]?.show(robot));
  }

  draw(time) {
    requestAnimationFrame((next) => this.draw(next));
    const passed_s = Math.min(0.1, (time - this.last) / 1e3);
    this.last = time;
    this.views.forEach((view, index) => {
      view.follow(this.orbit, passed_s);
      this.renderer.setViewport(...this.areas[index]);
      this.renderer.setScissor(...this.areas[index]);
      this.renderer.render(view.scene, view.camera);
    });
    this.count(time);
  }

  /** Counts pictures; where there are too few, they become coarser. */
  count(time) {
    this.frames += 1;
    if (time - this.since < 2e3) return;
    this.rate = (this.frames * 1e3) / (time - this.since);
    [this.frames, this.since] = [0, time];
    const { width, height } = this.renderer.domElement;
    if (this.rate > SLOW_HZ || document.hidden || !this.views.length || width * height < FEWEST) return;
    this.fineness = Math.min(FINENESS.length - 1, this.fineness + 1);
    this.resize();
  }
}
