// One robot as three.js objects: a group per body, and what is drawn beside it.

import * as THREE from "three";
import { robotColor } from "../tradeoffs.js";
import { colorOf, geometryOf, shownGeoms } from "./shapes.js";

const AHEAD = 0.25; // s that the arrow of a velocity looks ahead
const POINTS = 80; // of a trail
const ALONG = new THREE.Vector3(0, 1, 0); // the direction of three.js's cones
const GHOSTLY = 0.35; // opacity
const [FAR, WRONG] = [0.15, new THREE.Color("#c2255c")]; // m from the ghost, and the color there: #errors

export class Robot {
  /** The size is in meters; `index` is that of its color, or null without a ring. */
  constructor(model, size, index) {
    this.size = size;
    this.group = new THREE.Group(); // moves by what the robot has moved
    this.model = model;
    this.bodies = this.#addBodies(shownGeoms(model));
    this.ghost = null; // bodies of a robot that follows a motion perfectly
    this.arrows = {
      velocity: new Arrows(this.group, "#0072b2", size),
      command: new Arrows(this.group, "#009e73", size),
      contacts: new Arrows(this.group, "#d55e00", size),
    };
    this.trail = new THREE.Line(
      new THREE.BufferGeometry().setFromPoints(Array(POINTS).fill(new THREE.Vector3())),
      new THREE.LineBasicMaterial({ color: "#868e96" }),
    );
    this.trail.frustumCulled = false;
    this.group.add(this.trail);
    if (index === null) return;
    const ring = new THREE.RingGeometry(0.36 * size, 0.4 * size, 64);
    this.ring = new THREE.Mesh(ring, new THREE.MeshBasicMaterial({ color: robotColor(index) }));
    this.group.add(this.ring);
  }

  /** Move the bodies `share` of the way from one pose to another, and those of a ghost if it is `shown`. */
  pose(former, latest, share, shown) {
    move(this.bodies, former, latest, share);
    if (!latest.ghost) return;
    this.ghost ??= this.#addGhost();
    move(this.ghost, former.ghost, latest.ghost, share);
    const tells = shown.has("ghost") && shown.has("errors");
    for (const [i, ghost] of this.ghost.entries()) {
      ghost.visible = shown.has("ghost");
      const error = tells ? this.bodies[i].position.distanceTo(ghost.position) / FAR : 0;
      for (const { material, userData } of this.bodies[i].children) {
        material.color.lerpColors(userData.color, WRONG, Math.min(error, 1));
      }
    }
  }

  #addBodies(geoms) {
    const bodies = Array.from({ length: this.model.nbody }, () => new THREE.Group());
    this.group.add(...bodies);
    for (const geom of geoms) addGeom(bodies, this.model, geom);
    return bodies;
  }

  #addGhost() {
    const bodies = this.#addBodies(shownGeoms(this.model).filter((geom) => this.model.geom_bodyid[geom] > 0));
    for (const mesh of bodies.flatMap((body) => body.children)) {
      Object.assign(mesh.material, { transparent: true, opacity: GHOSTLY, depthWrite: false });
      mesh.material.color.set("#40a870");
      mesh.castShadow = mesh.receiveShadow = false;
    }
    return bodies;
  }

  /** Draw the arrows and the trail that are `shown`, by name, between two poses; `past` has those of the episode. */
  decorate(shown, { dt, followed }, command, [former, latest], past) {
    const placeIn = ({ places }) => new THREE.Vector3().fromArray(places, 3 * followed);
    const above = (share) => this.bodies[followed].position.clone().add(new THREE.Vector3(0, 0, share * this.size));
    const draw = (name, arrows) => this.arrows[name].show(shown.has(name) ? arrows : []);
    const seconds = (latest.steps - former.steps) * dt;
    const way = placeIn(latest).sub(placeIn(former));
    draw("velocity", seconds > 0 ? [[above(0.3), way.multiplyScalar(AHEAD / seconds)]] : []);
    const { z: heading } = new THREE.Euler().setFromQuaternion(quaternionAt(latest.turns, followed, turn), "ZYX");
    const reach = command && new THREE.Vector3(...command, 0).applyAxisAngle(UP, heading);
    draw("command", reach ? [[above(0.36), reach]] : []);
    draw("contacts", arrowsOf(latest.contacts ?? []));
    this.trail.visible = shown.has("trail") && past.length > 1;
    if (!this.trail.visible) return;
    const points = past.slice(-POINTS).map(placeIn);
    this.trail.geometry.setFromPoints(points).setDrawRange(0, points.length);
  }
}

function move(bodies, former, latest, share) {
  for (const [index, body] of bodies.entries()) {
    body.position.fromArray(former.places, 3 * index);
    body.position.lerp(place.fromArray(latest.places, 3 * index), share);
    quaternionAt(former.turns, index, body.quaternion);
    body.quaternion.slerp(quaternionAt(latest.turns, index, turn), share);
  }
}

const UP = new THREE.Vector3(0, 0, 1);
const place = new THREE.Vector3(); // reused, so that drawing allocates little
const turn = new THREE.Quaternion();

/** Read MuJoCo's quaternion, which has w first. */
export function quaternionAt(numbers, index, result) {
  const [w, x, y, z] = numbers.subarray(4 * index, 4 * index + 4);
  return result.set(x, y, z, w);
}

function addGeom(bodies, model, geom) {
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
  mesh.userData.color = material.color.clone(); // without errors
  bodies[model.geom_bodyid[geom]].add(mesh);
}

function arrowsOf(ends) {
  const point = (i) => new THREE.Vector3().fromArray(ends, 3 * i);
  return Array.from({ length: ends.length / 6 }, (_, i) => [point(2 * i), point(2 * i + 1).sub(point(2 * i))]);
}

// Arrows in the scene, as many as are needed at the moment: slender cones; the size is the robot's.
class Arrows {
  constructor(parent, color, size) {
    this.group = new THREE.Group();
    this.width = 0.015 * size;
    this.material = new THREE.MeshBasicMaterial({ color });
    this.cone = new THREE.ConeGeometry(this.width, 1, 16).translate(0, 0.5, 0);
    parent.add(this.group);
  }

  /** Show arrows, each from a point as far as a vector. */
  show(arrows) {
    const long = arrows.filter(([, reach]) => reach.length() > this.width);
    while (this.group.children.length < long.length) this.group.add(new THREE.Mesh(this.cone, this.material));
    this.group.children.forEach((cone, i) => {
      cone.visible = i < long.length;
      if (!cone.visible) return;
      const [from, reach] = long[i];
      cone.position.copy(from);
      cone.scale.y = reach.length();
      cone.quaternion.setFromUnitVectors(ALONG, reach.normalize());
    });
  }
}
