// The stage: robots side by side that stay in place while the ground moves, and a camera.

import * as THREE from "three";
import { OrbitControls } from "../libraries/OrbitControls.js";
import { Problem } from "../files.js";
import { html } from "../pictures.js";
import { robotColor, summary } from "../tradeoffs.js";
import { Capture } from "./capture.js";
import { Robot, quaternionAt } from "./robot.js";
import { PLANE, shownGeoms } from "./shapes.js";
import { Surroundings } from "./surroundings.js";

const VIEW = new THREE.Vector3(0.55, -1, 0.32).normalize(); // from the robots to the camera
const FIELD = 32; // degrees
const MARGIN = 1.2; // around the robots
const GAP = 1.15; // between the middles of neighbors, in sizes of the robot
const HEAD = 0.08; // from a robot's head to its name, in sizes of the robot
const BUTTONS = 50; // pixels that the buttons cover at the bottom
const KEPT = 10; // s of poses to look back at
const CALM = 250; // ms that the camera takes to follow most of a change of height
const LEVELS = [
  { share: 1, shadow: 2048 }, // of the screen's pixels in each direction, and pixels of the shadow
  { share: 0.7, shadow: 1024 },
  { share: 0.5, shadow: 512 },
];
const SLOW = 60; // ms of a frame
const LASTING = 3000; // ms of slow frames in a row until the level falls
const LONGEST = 500; // ms that count of one frame, because a hidden page draws none
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i; // WebGL without a graphics card

export class Stage {
  /** Draw on a canvas; `labels` is the element of the names. */
  constructor(canvas, labels) {
    Object.assign(this, { canvas, labels });
    this.capture = new Capture(canvas, labels);
    const accelerated = isAccelerated();
    const context = canvas.getContext("webgl2", { antialias: accelerated });
    if (!context) {
      throw new Problem("This browser cannot draw in 3D: switch on WebGL 2 (hardware acceleration).");
    }
    this.level = accelerated ? 0 : LEVELS.length - 1; // of quality
    this.slow = 0; // ms of slow frames in a row
    this.renderer = new THREE.WebGLRenderer({ canvas, context });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.camera = new THREE.PerspectiveCamera(FIELD, 1, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.enablePan = false;
    this.controls.cursorStyle = "grab";
    this.controls.maxPolarAngle = 0.495 * Math.PI; // never below the floor
    this.theme = "light";
    this.shown = new Set(); // what to draw beside the robots
    this.drawn = performance.now();
    this.center = new THREE.Vector3(); // where the camera looks
  }

  show(engine) {
    if (this.scene) release(this.scene);
    const { model, about, robots, scene } = engine;
    const same = this.model === model || this.engine?.isRecorded || scene.reshaped;
    const stays = this.width !== undefined && same && this.robots.length === robots.length;
    const many = robots.length > 1;
    Object.assign(this, { engine, model, source: scene });
    this.scene = new THREE.Scene();
    const box = boundsOf(model, robots[0]);
    this.size = Math.max(box.getSize(new THREE.Vector3()).length(), 0.05);
    const height = robots[0].places[3 * about.followed + 2];
    this.offset = box.getCenter(new THREE.Vector3()).z - height;
    this.head = box.max.z - height + HEAD * this.size;
    this.robots = robots.map((_, i) => new Robot(model, this.size, many ? i : null));
    const gap = GAP * this.size;
    this.lanes = robots.map((_, i) => gap * (i - (robots.length - 1) / 2));
    this.floor = floorHeight(model);
    this.surroundings = new Surroundings(this.scene, this.size, this.floor, this.lanes, gap);
    this.surroundings.dress(this.theme);
    this.scene.add(...this.robots.map(({ group }) => group));
    const tag = (_, i) => html("span", { className: "name-tag", style: `--color: ${robotColor(i)}` });
    this.labels.replaceChildren(...(many ? robots.map(tag) : []));
    this.past = []; // poses of all robots, the oldest first, and control steps until then
    this.clock = 0; // control steps since the robots are shown
    this.moment = null; // index of the past pose to draw; null: the present
    this.advance();
    if (!stays) this.lookHome(same);
  }

  dress(theme) {
    this.theme = theme;
    this.surroundings?.dress(theme);
  }

  /** Note the poses after a control step; `draw` moves from the former to these. */
  advance() {
    const { robots, about } = this.engine;
    if (robots.length !== this.robots.length) return;
    const [first] = this.past.at(-1) ?? [{ steps: -1 }];
    if (robots[0].steps === first.steps) return; // paused
    const poses = robots.map(({ places, turns, steps, contacts, ghost }) => {
      return { places: places.slice(), turns: turns.slice(), steps, contacts, ghost };
    });
    const { steps } = robots[0];
    this.clock += steps > first.steps ? steps - first.steps : steps;
    this.past.push(Object.assign(poses, { clock: this.clock }));
    while ((this.clock - this.past[0].clock) * about.dt > KEPT) this.past.shift();
  }

  /** Move the camera to where it was in the beginning; or only to the distance, if `turned`. */
  lookHome(turned = false) {
    const aspect = this.camera.aspect;
    const half = THREE.MathUtils.degToRad(FIELD / 2);
    const across = Math.atan(Math.tan(half) * aspect);
    const wide = this.lanes.at(-1) - this.lanes[0] + this.size;
    const distance = (MARGIN / 2) * Math.max(this.size / Math.sin(half), wide / Math.sin(across));
    const from = this.camera.position.clone().sub(this.controls.target);
    const direction = turned && from.length() > 0 ? from.normalize() : VIEW;
    this.center.set(0, 0, this.#height(1));
    this.controls.target.copy(this.center);
    this.camera.position.copy(direction).multiplyScalar(distance).add(this.center);
    this.controls.minDistance = 0.4 * this.size;
    this.controls.maxDistance = 12 * this.size + wide;
    this.controls.update();
  }

  picture() {
    this.draw(1);
    return this.capture.picture();
  }

  /** Draw the moment `share` in [0, 1] of the way from the former poses to the latest. */
  draw(share) {
    const now = performance.now();
    const haste = 1 - Math.exp((this.drawn - now) / CALM); // of a change of height to follow now
    this.#judge(now - this.drawn);
    this.drawn = now;
    this.#fit();
    this.surroundings.shadow = LEVELS[this.level].shadow;
    const ways = this.robots.map((robot, i) => {
      const [former, latest] = this.#drawn(i);
      robot.pose(former, latest, share, this.shown);
      const at = robot.bodies[this.engine.about.followed].position;
      robot.group.position.set(this.lanes[i] - at.x, -at.y, 0);
      robot.ring?.position.set(at.x, at.y, this.floor + 0.004 * this.size);
      if (this.moment === null) this.#decorate(robot, i);
      return at;
    });
    const rise = haste * (this.#height(share) - this.center.z);
    for (const point of [this.center, this.controls.target, this.camera.position]) point.z += rise;
    this.controls.update();
    this.surroundings.follow(ways, this.center);
    this.renderer.render(this.scene, this.camera);
    this.#placeLabels();
    if (this.capture.recorder) this.capture.copy(); // a browser forgets the drawing soon
  }

  /** Draw more coarsely where frames last long (ms), so that the robot moves in real time. */
  #judge(duration) {
    this.slow = duration > SLOW ? this.slow + Math.min(duration, LONGEST) : 0;
    if (this.slow < LASTING || this.level === LEVELS.length - 1) return;
    this.level += 1;
    this.slow = 0;
  }

  /** Return the poses of a robot to draw between. */
  #drawn(i) {
    if (this.moment !== null) return [this.past[this.moment][i], this.past[this.moment][i]];
    const [latest, former = latest] = [this.past.at(-1)[i], this.past.at(-2)?.[i]];
    return former.steps > latest.steps ? [latest, latest] : [former, latest]; // a new episode
  }

  /** Return the height to look at: that of the first robot. */
  #height(share) {
    const at = 3 * this.engine.about.followed + 2;
    const [former, latest] = this.#drawn(0);
    return THREE.MathUtils.lerp(former.places[at], latest.places[at], share) + this.offset;
  }

  #decorate(robot, i) {
    const { about, command, names } = this.engine;
    const begin = this.past.findLastIndex((pose, k) => k > 0 && this.past[k - 1][i].steps > pose[i].steps);
    const past = this.past.slice(Math.max(begin, 0)).map((poses) => poses[i]);
    const wanted = about.velocities && !names ? command.slice(0, 2) : null;
    robot.decorate(this.shown, about, wanted, this.#drawn(i), past);
  }

  /** Show the names of several robots at their heads. */
  #placeLabels() {
    const { names, robots, selected, about } = this.engine;
    for (const [i, label] of [...this.labels.children].entries()) {
      const text = names?.[i] ?? `${i + 1}: ${summary(robots[i].tradeoff, about.titles)}`;
      if (label.textContent !== text) label.textContent = text;
      label.classList.toggle("chosen", !names && i === selected);
      const { z } = this.robots[i].bodies[about.followed].position;
      const head = new THREE.Vector3(this.lanes[i], 0, z + this.head);
      const { x, y } = head.project(this.camera);
      label.style.left = `${((x + 1) / 2) * this.width}px`;
      label.style.top = `${THREE.MathUtils.clamp((1 - y) / 2, 0.02, 0.8) * this.tall}px`;
    }
  }

  /** Keep the drawing as large as its place on the page. */
  #fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    const ratio = Math.min(window.devicePixelRatio, 2) * LEVELS[this.level].share;
    if (width === this.width && height === this.tall && ratio === this.ratio) return;
    Object.assign(this, { width, tall: height, ratio });
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    const before = this.camera.aspect;
    this.camera.aspect = width / Math.max(height, 1);
    this.camera.setViewOffset(width, height, 0, BUTTONS / 2, width, height);
    this.camera.updateProjectionMatrix();
    if (Math.abs(before - this.camera.aspect) > 0.01) this.lookHome();
  }
}

/** Free what a scene has on the graphics card. */
function release(scene) {
  scene.background.dispose();
  scene.traverse((part) => {
    part.dispose?.(); // the shadow of a light
    part.geometry?.dispose();
    part.material?.map?.dispose();
    part.material?.dispose();
  });
}

/** Return a box around what moves. */
function boundsOf(model, { places, turns }) {
  const box = new THREE.Box3();
  for (const geom of shownGeoms(model)) {
    const body = model.geom_bodyid[geom];
    if (body === 0) continue;
    const center = new THREE.Vector3().fromArray(model.geom_pos, 3 * geom);
    center.applyQuaternion(quaternionAt(turns, body, new THREE.Quaternion()));
    center.add(new THREE.Vector3().fromArray(places, 3 * body));
    const radius = model.geom_rbound[geom];
    box.union(new THREE.Box3(center.clone().subScalar(radius), center.addScalar(radius)));
  }
  if (box.isEmpty()) box.set(new THREE.Vector3(-1, -1, 0), new THREE.Vector3(1, 1, 1));
  return box;
}

/** Return the height of the model's ground plane; 0 if it has none. */
function floorHeight(model) {
  const plane = model.geom_type.findIndex((type, geom) => type === PLANE && model.geom_bodyid[geom] === 0);
  return plane < 0 ? 0 : model.geom_pos[3 * plane + 2];
}

/** Return whether a graphics card draws, and not the processor. */
function isAccelerated() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return false;
  const details = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(details?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext(); // browsers allow a few contexts only
  return !SOFTWARE.test(name);
}
