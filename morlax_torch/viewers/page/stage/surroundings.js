// Sky, floor and lights, in a light and a dark version.

import * as THREE from "three";

const LOOKS = {
  light: { zenith: "#7fb2e6", horizon: "#e9eff6", tiles: ["#e3e8ee", "#cbd5e1"], sky: 1.6 },
  dark: { zenith: "#0d1526", horizon: "#33415a", tiles: ["#525c6e", "#434d5e"], sky: 1.7 },
};
const TILES = 200; // along each side of an endless floor
const SUN = new THREE.Vector3(-0.45, -0.6, 1.15); // from here it shines

export class Surroundings {
  /** Scale tiles, shadow and fog to the robot's size in m; several lanes, `gap` apart, have a floor each. */
  constructor(scene, size, floorHeight, lanes, gap) {
    this.scene = scene;
    this.scene.backgroundRotation.x = Math.PI / 2; // three.js's sky is above y, MuJoCo's above z
    this.size = size;
    this.tile = size > 1 ? 1 : 0.25;
    this.sun = sunlight(size, lanes.at(-1));
    this.fill = new THREE.HemisphereLight();
    const endless = TILES * this.tile;
    const width = lanes.length > 1 ? 0.95 * gap : endless;
    this.floors = lanes.map((x) => {
      const floor = plainFloor(width, endless);
      floor.position.set(x, 0, floorHeight);
      return floor;
    });
    this.width = width;
    this.tall = endless;
    this.beneath = plainFloor(endless, endless);
    this.beneath.position.z = floorHeight - 0.01 * size;
    this.beneath.visible = lanes.length > 1;
    scene.add(this.sun, this.sun.target, this.fill, ...this.floors, this.beneath);
    scene.fog = new THREE.Fog("white", 7 * size, 26 * size + 2 * lanes.at(-1));
  }

  /** Change to the light or the dark version. */
  dress(theme) {
    const look = LOOKS[theme];
    this.scene.background?.dispose();
    this.scene.background = sky(look);
    this.scene.fog.color.set(look.horizon);
    this.fill.color.set(look.zenith).lerp(new THREE.Color("white"), 0.6);
    this.fill.groundColor.set(look.tiles[0]);
    this.fill.intensity = look.sky;
    this.beneath.material.color.set(look.horizon);
    for (const { material } of this.floors) {
      material.map?.dispose();
      material.map = checker(look.tiles);
      material.map.repeat.set(this.width / (2 * this.tile), this.tall / (2 * this.tile));
      material.needsUpdate = true;
    }
  }

  /** Cast a shadow of so many pixels in each direction. */
  set shadow(pixels) {
    const { shadow } = this.sun;
    if (shadow.mapSize.x === pixels) return;
    shadow.mapSize.set(pixels, pixels);
    shadow.map?.dispose();
    shadow.map = null; // three.js makes another
  }

  /** Show the ground at the robots' places in their worlds; the camera looks at `center`. */
  follow(ways, center) {
    const turn = 2 * this.tile;
    for (const [i, { material }] of this.floors.entries()) {
      const { x, y } = ways[i];
      material.map.offset.set(((x - this.width / 2) / turn) % 1, ((y - this.tall / 2) / turn) % 1);
    }
    this.sun.target.position.copy(center);
    this.sun.position.copy(SUN).multiplyScalar(4 * this.size).add(center);
  }
}

/** Paint a sky from the horizon up to the zenith, where z is up. */
function sky({ zenith, horizon }) {
  const canvas = Object.assign(document.createElement("canvas"), { width: 1, height: 256 });
  const context = canvas.getContext("2d");
  for (let y = 0; y < canvas.height; y++) {
    const height = Math.max(Math.cos((Math.PI * y) / canvas.height), 0);
    const color = new THREE.Color(horizon).lerp(new THREE.Color(zenith), Math.sqrt(height));
    context.fillStyle = color.getStyle();
    context.fillRect(0, y, 1, 1);
  }
  const texture = new THREE.CanvasTexture(canvas, THREE.EquirectangularReflectionMapping);
  texture.colorSpace = THREE.SRGBColorSpace;
  return texture;
}

/** @param aside half the distance between the outermost robots. */
function sunlight(size, aside) {
  const sun = new THREE.DirectionalLight("#fff4e6", 2.6);
  sun.castShadow = true;
  sun.shadow.radius = 3;
  sun.shadow.normalBias = 0.01 * size;
  const reach = 1.7 * size + aside;
  const camera = sun.shadow.camera;
  Object.assign(camera, { left: -reach, right: reach, top: reach, bottom: -reach });
  Object.assign(camera, { near: 0.1 * size, far: 10 * size + 2 * aside });
  return sun;
}

function plainFloor(width, height) {
  const material = new THREE.MeshLambertMaterial(); // cheaper than others, on most of the picture
  const floor = new THREE.Mesh(new THREE.PlaneGeometry(width, height), material);
  floor.receiveShadow = true;
  return floor;
}

function checker([one, other]) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 128;
  const context = canvas.getContext("2d");
  context.fillStyle = one;
  context.fillRect(0, 0, 128, 128);
  context.fillStyle = other;
  context.fillRect(0, 0, 64, 64);
  context.fillRect(64, 64, 64, 64);
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.anisotropy = 8;
  return texture;
}
