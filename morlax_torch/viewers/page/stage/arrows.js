// Arrows in the scene, as many as are needed at the moment.

import * as THREE from "three";

const UP = new THREE.Vector3(0, 1, 0); // the direction of three.js's cylinders and cones
const SHORTEST = 3; // times the width; shorter arrows are left out

export class Arrows {
  /** @param size of the robot in meters, which sets the arrows' width. */
  constructor(parent, color, size) {
    this.group = new THREE.Group();
    this.width = 0.008 * size;
    this.material = new THREE.MeshBasicMaterial({ color });
    this.shaft = new THREE.CylinderGeometry(this.width, this.width, 1, 12).translate(0, 0.5, 0);
    this.head = new THREE.ConeGeometry(2.2 * this.width, 4 * this.width, 16);
    parent.add(this.group);
  }

  /** Show arrows, each from one point to another. */
  show(arrows) {
    const long = arrows.filter(([a, b]) => a.distanceTo(b) > SHORTEST * this.width);
    while (this.group.children.length < long.length) this.group.add(this.#arrow());
    this.group.children.forEach((arrow, i) => {
      arrow.visible = i < long.length;
      if (arrow.visible) this.#place(arrow, ...long[i]);
    });
  }

  #arrow() {
    const arrow = new THREE.Group();
    arrow.add(new THREE.Mesh(this.shaft, this.material), new THREE.Mesh(this.head, this.material));
    return arrow;
  }

  #place(arrow, from, to) {
    const reach = to.clone().sub(from);
    const length = reach.length();
    const [shaft, head] = arrow.children;
    arrow.position.copy(from);
    arrow.quaternion.setFromUnitVectors(UP, reach.divideScalar(length));
    shaft.scale.set(1, length - 2 * this.width, 1);
    head.position.set(0, length - 2 * this.width, 0);
  }
}
