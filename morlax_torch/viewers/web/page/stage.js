// The robot on its stage: three.js objects for every body, and a camera that follows.

import * as THREE from "three";
import { OrbitControls } from "./libraries/OrbitControls.js";
import { Problem } from "./files.js";
import { Quality, isAccelerated } from "./quality.js";
import { PLANE, colorOf, geometryOf, shownGeoms } from "./shapes.js";
import { Surroundings } from "./surroundings.js";

const VIEW = new THREE.Vector3(0.55, -1, 0.32).normalize(); // from the robot to the camera
const FIELD = 32; // degrees
const MARGIN = 1.2; // around the robot
const BUTTONS = 50; // pixels that the buttons cover at the bottom
const KEPT = 10; // s of poses to look back at
const CALM = 250; // ms that the camera takes to follow most of a change of height

export class Stage {
  constructor(canvas) {
    this.canvas = canvas;
    const accelerated = isAccelerated();
    const context = canvas.getContext("webgl2", { antialias: accelerated });
    if (!context) {
      throw new Problem("This browser cannot draw in 3D: switch on WebGL 2 (hardware acceleration).");
    }
    this.quality = new Quality(accelerated);
    this.renderer = new THREE.WebGLRenderer({ canvas, context });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.camera = new THREE.PerspectiveCamera(FIELD, 1, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.enablePan = false;
    this.controls.maxPolarAngle = 0.495 * Math.PI; // never below the floor
    this.theme = "light";
    this.haste = 1; // share of a change of height to follow now
    this.drawn = performance.now();
  }

  /** Show another robot: a `Simulation` after its reset. */
  show(simulation) {
    this.scene?.traverse((object) => object.geometry?.dispose());
    const { model, data, about } = simulation;
    this.simulation = simulation;
    this.scene = new THREE.Scene();
    this.bodies = Array.from({ length: model.nbody }, () => new THREE.Group());
    this.scene.add(...this.bodies);
    const shown = shownGeoms(model);
    for (const geom of shown) this.#addGeom(model, geom);
    const box = boundsOf(model, data, shown);
    this.size = Math.max(box.getSize(new THREE.Vector3()).length(), 0.05);
    this.offset = box.getCenter(new THREE.Vector3()).z - data.xpos[3 * about.followed + 2];
    this.surroundings = new Surroundings(this.scene, this.size, floorHeight(model, data));
    this.surroundings.dress(this.theme);
    this.followed = about.followed;
    this.center = null;
    this.past = []; // poses after control steps, the oldest first
    this.moment = null; // index of the past pose to draw; null: the present
    this.jump();
    this.lookHome();
  }

  /** Change to the light or dark look. */
  dress(theme) {
    this.theme = theme;
    this.surroundings?.dress(theme);
  }

  /** Note the poses after a control step; `draw` moves from the former to these. */
  advance() {
    this.former = this.latest;
    this.#note();
  }

  /** Take the present poses without moving to them, as after a reset. */
  jump() {
    this.#note();
    this.former = this.latest;
    if (this.center) this.#carry(this.#placeOfRobot(1));
  }

  /** Move the camera to where it was in the beginning. */
  lookHome() {
    this.center = this.#placeOfRobot(1);
    const aspect = this.camera.aspect;
    const half = THREE.MathUtils.degToRad(FIELD / 2);
    const narrow = Math.min(half, Math.atan(Math.tan(half) * aspect));
    const distance = (MARGIN * this.size) / 2 / Math.sin(narrow);
    this.controls.target.copy(this.center);
    this.camera.position.copy(VIEW).multiplyScalar(distance).add(this.center);
    this.controls.minDistance = 0.4 * this.size;
    this.controls.maxDistance = 12 * this.size;
    this.controls.update();
  }

  /** Return a picture of the present drawing, as a PNG file's data. */
  picture() {
    this.draw(1);
    return new Promise((resolve) => this.canvas.toBlob(resolve));
  }

  /** Draw the moment `share` in [0, 1] of the way from the former poses to the latest. */
  draw(share) {
    const now = performance.now();
    this.haste = 1 - Math.exp((this.drawn - now) / CALM);
    this.quality.note(now - this.drawn);
    this.drawn = now;
    this.#fit();
    this.surroundings.shadow = this.quality.shadow;
    const [former, latest] = this.#drawn();
    for (const [index, body] of this.bodies.entries()) {
      body.position.fromArray(former.places, 3 * index);
      body.position.lerp(place.fromArray(latest.places, 3 * index), share);
      quaternionAt(former.turns, index, body.quaternion);
      body.quaternion.slerp(quaternionAt(latest.turns, index, turn), share);
    }
    this.#carry(this.#placeOfRobot(share));
    this.controls.update();
    this.surroundings.follow(this.center, this.camera.position);
    this.renderer.render(this.scene, this.camera);
  }

  #note() {
    const { data, steps, about } = this.simulation;
    this.latest = { places: data.xpos.slice(), turns: data.xquat.slice(), steps };
    this.past.push(this.latest);
    if (this.past.length * about.dt > KEPT) this.past.shift();
  }

  /** Return the poses to draw between. */
  #drawn() {
    if (this.moment === null) return [this.former, this.latest];
    return [this.past[this.moment], this.past[this.moment]];
  }

  #addGeom(model, geom) {
    const geometry = geometryOf(model, geom);
    if (!geometry) return;
    const [red, green, blue, alpha] = colorOf(model, geom);
    const material = new THREE.MeshStandardMaterial({
      color: new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace),
      roughness: 0.42,
      metalness: 0.05,
      transparent: alpha < 1,
      opacity: alpha,
    });
    const mesh = new THREE.Mesh(geometry, material);
    mesh.position.fromArray(model.geom_pos, 3 * geom);
    quaternionAt(model.geom_quat, geom, mesh.quaternion);
    mesh.castShadow = mesh.receiveShadow = true;
    this.bodies[model.geom_bodyid[geom]].add(mesh);
  }

  /** Return where the camera looks: at the robot, but slow upward, so that steps do not shake it. */
  #placeOfRobot(share) {
    const at = 3 * this.followed;
    const { lerp } = THREE.MathUtils;
    const [former, latest] = this.#drawn();
    const along = (i) => lerp(former.places[at + i], latest.places[at + i], share);
    const height = along(2) + this.offset;
    return new THREE.Vector3(along(0), along(1), lerp(this.center?.z ?? height, height, this.haste));
  }

  /** Move camera and target with the robot. */
  #carry(center) {
    const shift = center.clone().sub(this.center);
    this.camera.position.add(shift);
    this.controls.target.add(shift);
    this.center = center;
  }

  /** Keep the drawing as large as its place on the page. */
  #fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    const ratio = Math.min(window.devicePixelRatio, 2) * this.quality.share;
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

const place = new THREE.Vector3(); // reused, so that drawing allocates little
const turn = new THREE.Quaternion();

/** Read MuJoCo's quaternion, which has w first. */
function quaternionAt(numbers, index, result) {
  const [w, x, y, z] = numbers.subarray(4 * index, 4 * index + 4);
  return result.set(x, y, z, w);
}

/** Return a box around what moves. */
function boundsOf(model, data, geoms) {
  const box = new THREE.Box3();
  for (const geom of geoms) {
    if (model.geom_bodyid[geom] === 0) continue;
    const radius = model.geom_rbound[geom];
    const center = new THREE.Vector3().fromArray(data.geom_xpos, 3 * geom);
    box.union(new THREE.Box3(center.clone().subScalar(radius), center.addScalar(radius)));
  }
  if (box.isEmpty()) box.set(new THREE.Vector3(-1, -1, 0), new THREE.Vector3(1, 1, 1));
  return box;
}

/** Return the height of the model's ground plane; 0 if it has none. */
function floorHeight(model, data) {
  const planes = Array.from({ length: model.ngeom }, (_, geom) => geom).filter(
    (geom) => model.geom_type[geom] === PLANE,
  );
  return planes.length ? data.geom_xpos[3 * planes[0] + 2] : 0;
}
