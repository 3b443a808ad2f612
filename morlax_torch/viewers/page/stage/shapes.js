// The shapes of a MuJoCo model as three.js geometries; MuJoCo's lengths are half lengths.

import * as THREE from "three";

// mjtGeom
export const PLANE = 0;
const [HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH] = [1, 2, 3, 4, 5, 6, 7];
const SHOWN_GROUPS = 3; // MuJoCo's viewers hide groups 3, 4 and 5
const UNSET = [0.5, 0.5, 0.5, 1]; // mjModel's color of a geom that has none of its own

/** Return the indices of the geoms that MuJoCo's viewers show. */
export function shownGeoms(model) {
  const all = Array.from({ length: model.ngeom }, (_, geom) => geom);
  return all.filter((geom) => model.geom_group[geom] < SHOWN_GROUPS && colorOf(model, geom)[3] > 0);
}

/** Return red, green, blue and alpha of a geom, or of its material. */
export function colorOf(model, geom) {
  const color = Array.from(model.geom_rgba.subarray(4 * geom, 4 * geom + 4));
  const material = model.geom_matid[geom];
  const isUnset = color.every((x, i) => Math.abs(x - UNSET[i]) < 1e-6);
  if (material < 0 || !isUnset) return color;
  return Array.from(model.mat_rgba.subarray(4 * material, 4 * material + 4));
}

/** Return the geometry of a geom in its own frame; null for shapes that are not drawn. */
export function geometryOf(model, geom) {
  const [x, y, z] = model.geom_size.subarray(3 * geom, 3 * geom + 3);
  switch (model.geom_type[geom]) {
    case SPHERE:
      return new THREE.SphereGeometry(x, 40, 24);
    case ELLIPSOID:
      return new THREE.SphereGeometry(1, 40, 24).scale(x, y, z);
    case CAPSULE:
      return new THREE.CapsuleGeometry(x, 2 * y, 16, 32).rotateX(Math.PI / 2);
    case CYLINDER:
      return new THREE.CylinderGeometry(x, x, 2 * y, 40).rotateX(Math.PI / 2);
    case BOX:
      return new THREE.BoxGeometry(2 * x, 2 * y, 2 * z);
    case MESH:
      return meshGeometry(model, model.geom_dataid[geom]);
    case HFIELD:
      return terrain(model, model.geom_dataid[geom]);
    default:
      return null;
  }
}

/** Return a mesh with a corner of its own for each face, because faces may not share normals. */
function meshGeometry(model, mesh) {
  const begin = 3 * model.mesh_faceadr[mesh];
  const end = begin + 3 * model.mesh_facenum[mesh];
  const gathered = (vectors, first, indices) => {
    const numbers = Array.from(indices.subarray(begin, end), (index) => {
      return Array.from(vectors.subarray(3 * (first + index), 3 * (first + index) + 3));
    });
    return new THREE.Float32BufferAttribute(numbers.flat(), 3);
  };
  const points = gathered(model.mesh_vert, model.mesh_vertadr[mesh], model.mesh_face);
  const normals = gathered(model.mesh_normal, model.mesh_normaladr[mesh], model.mesh_facenormal);
  return new THREE.BufferGeometry().setAttribute("position", points).setAttribute("normal", normals);
}

/** Return the surface of a height field. */
function terrain(model, field) {
  const [width, depth, height] = model.hfield_size.subarray(4 * field, 4 * field + 3);
  const rows = model.hfield_nrow[field];
  const columns = model.hfield_ncol[field];
  const first = model.hfield_adr[field];
  const geometry = new THREE.PlaneGeometry(2 * width, 2 * depth, columns - 1, rows - 1);
  const points = geometry.getAttribute("position");
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      // three.js begins at the far edge, MuJoCo at the near one.
      const at = (rows - 1 - row) * columns + column;
      points.setZ(at, height * model.hfield_data[first + row * columns + column]);
    }
  }
  geometry.computeVertexNormals();
  return geometry;
}
