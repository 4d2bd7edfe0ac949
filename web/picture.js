// The picture: the robots' views side by side, drawn as finely as the machine can.

import * as THREE from "./three.module.min.js";
import { listenToHand } from "./hand.js";
import { pattern } from "./shapes.js";
import { View } from "./view.js";

const TINTS = [0x0072b2, 0xe69f00];
/** Frame rate below which the picture becomes coarser, the parts of its resolution that are tried, and the gain for which it stays so. */
const [SLOW_HZ, FINENESS, GAIN] = [50, [1, 0.75, 0.5, 0.35], 1.05];
/** Field of view of a view that is higher than wide, across, and of others, upright [rad]. */
const [ACROSS_RAD, UPRIGHT_RAD] = [0.56, 0.61];

/** True where no graphics processor draws. */
const IS_SOFTWARE = (() => {
  const context = document.createElement("canvas").getContext("webgl2");
  const about = context?.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|software/i.test(about ? context.getParameter(about.UNMASKED_RENDERER_WEBGL) : "");
})();

/** Draws robots into an element; `on` are the calls of listenToHand. */
export class Picture {
  constructor(place, on) {
    Object.assign(this, { place, views: [], areas: [], poses: null, fineness: IS_SOFTWARE ? 1 : 0, last: 0, rate: null });
    this.orbit = { around: -2.25, above: 0.5, away: 2.2 };
    this.renderer = new THREE.WebGLRenderer({ antialias: !IS_SOFTWARE, stencil: true, powerPreference: "high-performance" });
    this.renderer.setScissorTest(true);
    place.append(this.renderer.domElement);
    this.countAnew();
    new ResizeObserver(() => this.resize()).observe(place);
    listenToHand(this, on);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint());
    document.addEventListener("visibilitychange", () => this.countAnew());
    this.renderer.setAnimationLoop((time) => this.draw(time));
  }

  /** Begins with other robots: their drawn parts. */
  begin(parts) {
    this.views.forEach((view) => view.delete());
    this.views = parts.map((own, index) => new View(own, TINTS[index]));
    this.poses = null;
    this.paint();
    this.resize();
    this.countAnew();
  }

  paint() {
    // A colour of the style sheet, as it is in the present scheme.
    const colour = (name) => {
      this.place.style.color = `var(--${name})`;
      return getComputedStyle(this.place).color;
    };
    this.ground?.dispose();
    this.ground = pattern(colour("square"), colour("other"), colour("grid"));
    this.ground.anisotropy = IS_SOFTWARE ? 1 : 8;
    this.views.forEach((view) => view.paint(colour("sky"), this.ground));
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

  draw(time) {
    const passed_s = (time - this.last) / 1e3;
    this.last = time;
    this.count(time); // First: a change of the size clears the picture.
    this.views.forEach((view, index) => {
      if (this.poses) view.show(this.poses[index]);
      if (!view.trunk) return;
      view.follow(this.orbit, passed_s);
      this.renderer.setViewport(...this.areas[index]);
      this.renderer.setScissor(...this.areas[index]);
      this.renderer.render(view.scene, view.camera);
    });
    this.poses = null;
  }

  countAnew() {
    Object.assign(this, { frames: 0, since: performance.now(), finer_hz: null, isSettled: false });
  }

  /** Counts pictures; where there are too few, they become coarser while this helps: a browser that saves power draws no faster. */
  count(time) {
    this.frames += 1;
    if (time - this.since < 2e3) return;
    this.rate = (this.frames * 1e3) / (time - this.since);
    [this.frames, this.since] = [0, time];
    if (this.rate > SLOW_HZ || this.isSettled || this.fineness + 1 === FINENESS.length || !this.views.length) return;
    this.isSettled = this.rate < GAIN * this.finer_hz;
    [this.fineness, this.finer_hz] = [this.fineness + (this.isSettled ? -1 : 1), this.rate];
    this.resize();
  }
}
