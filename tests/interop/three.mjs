// Loads GLBs with three.js' GLTFLoader, plays every clip and compares the vertices with our own forward kinematics.
// node three.mjs FOLDER   (NAME.glb beside NAME.json made by expected.py)
import { readFileSync, readdirSync } from 'node:fs';
import { join } from 'node:path';

globalThis.self = globalThis;
// Textures do not matter here: an image of one pixel stands for each.
globalThis.createImageBitmap = async () => ({ width: 1, height: 1, close() {} });
const THREE = await import('three');
const { GLTFLoader } = await import('three/examples/jsm/loaders/GLTFLoader.js');

const { MeshoptDecoder } = await import('three/examples/jsm/libs/meshopt_decoder.module.js');

function vertices(gltf, mesh_nodes) {
  const out = [];
  const p = new THREE.Vector3();
  for (const mesh of mesh_nodes) {
    const count = mesh.geometry.attributes.position.count;
    for (let i = 0; i < count; i++) {
      mesh.getVertexPosition(i, p);
      p.applyMatrix4(mesh.matrixWorld);
      out.push(p.x, p.y, p.z);
    }
  }
  return out;
}

async function check(folder, name) {
  const bytes = readFileSync(join(folder, `${name}.glb`));
  const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
  const gltf = await new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).parseAsync(buffer, '');
  const expected = JSON.parse(readFileSync(join(folder, `${name}.json`)));
  const found = [];
  gltf.scene.traverse((object) => {
    if (!object.isMesh) return;
    const at = gltf.parser.associations.get(object) ?? {};
    const parent = gltf.parser.associations.get(object.parent) ?? {};
    found.push({ object, key: [at.nodes ?? parent.nodes, at.primitives ?? 0] });
  });
  found.sort((a, b) => a.key[0] - b.key[0] || a.key[1] - b.key[1]);
  const meshes = found.map((f) => f.object);
  let worst = 0;
  for (const [k, clip] of expected.clips.entries()) {
    const mixer = new THREE.AnimationMixer(gltf.scene);
    const action = mixer.clipAction(gltf.animations[k]);
    action.setLoop(THREE.LoopOnce);
    action.clampWhenFinished = true;
    action.play();
    for (const [s, time] of clip.times.entries()) {
      mixer.setTime(Math.min(time, gltf.animations[k].duration));
      gltf.scene.updateMatrixWorld(true);
      const ours = clip.vertices[s];
      const theirs = vertices(gltf, meshes);
      if (ours.length !== theirs.length) throw new Error(`${name}: ${theirs.length / 3} vertices, expected ${ours.length / 3}`);
      for (let i = 0; i < ours.length; i += 3) {
        const d = Math.hypot(ours[i] - theirs[i], ours[i + 1] - theirs[i + 1], ours[i + 2] - theirs[i + 2]);
        worst = Math.max(worst, d / expected.diagonal / expected.tolerance);
      }
    }
    action.stop();
    mixer.uncacheRoot(gltf.scene);
  }
  return worst;
}

const folder = process.argv[2];
let bad = 0;
const names = readdirSync(folder).filter((f) => f.endsWith('.json')).map((f) => f.slice(0, -5)).sort();
let overall = 0;
for (const name of names) {
  let worst = NaN;
  try {
    worst = await check(folder, name);
  } catch (error) {
    console.log(`${name}: ${error.message}`);
  }
  if (!(worst <= 1)) {
    bad += 1;
    console.log(`three.js ${name}: ${worst.toFixed(2)} times the tolerance`);
  } else {
    overall = Math.max(overall, worst);
  }
}
console.log(`three.js: ${names.length - bad} of ${names.length} files within their tolerance (1e-4 of the diagonal, or the residual told), worst of these ${overall.toFixed(2)} of it`);
process.exit(bad > 0 ? 1 : 0);
