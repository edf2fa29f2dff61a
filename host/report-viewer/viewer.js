// The report's turnable view: the cloud, the fitted plane, the vein's section plane and the needle
// (as in the paper's Figure 23). Data stand in the page as JSON; nothing is fetched.
import {
  BufferAttribute, BufferGeometry, CylinderGeometry, DoubleSide, Float32BufferAttribute,
  Group, Line, LineBasicMaterial, LineLoop, MathUtils, Mesh, MeshBasicMaterial, PerspectiveCamera, Points, PointsMaterial,
  Quaternion, Raycaster, Scene, SphereGeometry, Vector2, Vector3, WebGLRenderer,
} from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';

const bytes = (b64) => Uint8Array.from(atob(b64), (c) => c.charCodeAt(0));

// Viridis, eight stops: ordered in lightness, safe for the colour-blind.
const VIRIDIS = [[68, 1, 84], [70, 50, 127], [54, 92, 141], [39, 127, 142], [31, 161, 135], [74, 194, 109], [159, 218, 58], [253, 231, 37]];
function viridis(t, out, i) {
  const x = Math.min(Math.max(t, 0), 1) * (VIRIDIS.length - 1), k = Math.min(Math.floor(x), VIRIDIS.length - 2), f = x - k;
  for (let c = 0; c < 3; c++) out[i + c] = Math.round(VIRIDIS[k][c] * (1 - f) + VIRIDIS[k + 1][c] * f);
}

function quad(corners, colour, opacity) {
  const g = new BufferGeometry();
  g.setAttribute('position', new Float32BufferAttribute(corners.flat(), 3));
  g.setIndex([0, 1, 2, 0, 2, 3]);
  const group = new Group();
  group.add(new Mesh(g, new MeshBasicMaterial({ color: colour, transparent: true, opacity, side: DoubleSide, depthWrite: false })));
  const outline = new BufferGeometry(); // without the triangles' index
  outline.setAttribute('position', g.getAttribute('position'));
  group.add(new LineLoop(outline, new LineBasicMaterial({ color: colour })));
  return group;
}

function rod(from, to, radius, colour) {
  const a = new Vector3(...from), b = new Vector3(...to), d = b.clone().sub(a);
  const m = new Mesh(new CylinderGeometry(radius, radius, d.length(), 24), new MeshBasicMaterial({ color: colour }));
  m.position.copy(a).addScaledVector(d, 0.5);
  m.quaternion.copy(new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), d.normalize()));
  return m;
}

function start(host, data) {
  const panel = host.closest('.scene') ?? host; // the view and its controls
  const canvas = host.querySelector('canvas'), label = host.querySelector('.under-pointer');
  let renderer;
  try {
    renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
  } catch {
    host.classList.add('no-webgl');
    return;
  }
  const scene = new Scene(), camera = new PerspectiveCamera(35, 1, 1, 5000);
  const position = new Float32Array(bytes(data.positions).buffer), brightness = bytes(data.brightness);
  const n = brightness.length, geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(position, 3));
  const height = new Uint8Array(3 * n), grey = new Uint8Array(3 * n);
  const [lo, hi] = data.height_range;
  for (let i = 0; i < n; i++) {
    // Height towards the camera: −Z.
    viridis((hi - position[3 * i + 2]) / (hi - lo || 1), height, 3 * i);
    const g = 40 + Math.round(brightness[i] * 0.8);
    grey.fill(g, 3 * i, 3 * i + 3);
  }
  const colours = { height: new BufferAttribute(height, 3, true), brightness: new BufferAttribute(grey, 3, true) };
  geometry.setAttribute('color', colours.height);
  const cloud = new Points(geometry, new PointsMaterial({ size: 2.5 * data.point_size, vertexColors: true, sizeAttenuation: true }));
  const layers = { cloud };
  if (data.plane) layers.plane = quad(data.plane, 0x0072b2, 0.25);
  if (data.section) layers.section = quad(data.section, 0xcc79a7, 0.2);
  if (data.vein) {
    const g = new BufferGeometry();
    g.setAttribute('position', new Float32BufferAttribute(data.vein.flat(), 3));
    layers.vein = new Line(g, new LineBasicMaterial({ color: 0x56b4e9 }));
  }
  if (data.region) {
    const g = new BufferGeometry();
    g.setAttribute('position', new Float32BufferAttribute(data.region.flat(), 3));
    layers.region = new LineLoop(g, new LineBasicMaterial({ color: 0x009e73 }));
  }
  if (data.sight) layers.sight = rod(data.sight[0], data.sight[1], 0.2, 0xd55e00);
  if (data.needle) {
    const group = new Group();
    group.add(rod(data.needle.from, data.needle.entry, data.needle.radius, 0x888888));
    group.add(rod(data.needle.entry, data.needle.to, data.needle.radius, 0xd55e00));
    const ball = new Mesh(new SphereGeometry(2 * data.needle.radius, 24, 16), new MeshBasicMaterial({ color: 0xd55e00 }));
    ball.position.set(...data.needle.entry);
    group.add(ball);
    layers.needle = group;
  }
  for (const l of Object.values(layers)) scene.add(l);

  const controls = new OrbitControls(camera, canvas);
  controls.enableDamping = false;
  controls.zoomToCursor = true;
  const scale = panel.querySelector('.scale');
  const legend = (kind) => {
    if (!scale) return;
    scale.classList.toggle('grey', kind === 'brightness');
    const [low, high] = kind === 'height' ? [`Z ${hi.toFixed(1)} mm (far)`, `${lo.toFixed(1)} mm (near)`] : ['dark', 'bright'];
    scale.querySelector('.low').textContent = low;
    scale.querySelector('.high').textContent = high;
  };
  legend('height');
  const focus = new Vector3(...data.focus);
  const shown = [...position, ...(data.needle ? [...data.needle.from, ...data.needle.to] : []), ...(data.region ?? []).flat()];
  const first = () => {
    camera.up.set(...data.up);
    // As near as the whole cloud and the needle allow: a point (x, y, z) of a frame that looks along
    // −z at the centre is seen from the distance z + max(|x|/tan(width/2), |y|/tan(height/2)).
    const back = new Vector3(...data.view).normalize();
    const right = new Vector3().crossVectors(camera.up, back).normalize(), above = new Vector3().crossVectors(back, right);
    const tall = Math.tan(MathUtils.degToRad(camera.fov / 2)), wide = tall * camera.aspect, p = new Vector3();
    // The middle of what is shown stands in the middle of the view.
    const across = [Infinity, -Infinity], up = [Infinity, -Infinity];
    const widen = (range, x) => { range[0] = Math.min(range[0], x); range[1] = Math.max(range[1], x); };
    for (let i = 0; i < shown.length; i += 3) {
      p.set(shown[i], shown[i + 1], shown[i + 2]).sub(focus);
      widen(across, p.dot(right));
      widen(up, p.dot(above));
    }
    const centre = focus.clone().addScaledVector(right, (across[0] + across[1]) / 2).addScaledVector(above, (up[0] + up[1]) / 2);
    let far = 0;
    for (let i = 0; i < shown.length; i += 3) {
      p.set(shown[i], shown[i + 1], shown[i + 2]).sub(centre);
      far = Math.max(far, p.dot(back) + Math.max(Math.abs(p.dot(right)) / wide, Math.abs(p.dot(above)) / tall));
    }
    camera.position.copy(centre).addScaledVector(back, 1.04 * far);
    controls.target.copy(centre);
    controls.update();
  };
  let due = false;
  const draw = () => { due = false; renderer.render(scene, camera); };
  const ask = () => { if (!due) { due = true; requestAnimationFrame(draw); } };
  controls.addEventListener('change', ask);
  const size = () => {
    const w = host.clientWidth, h = Math.round(Math.min(w * 0.62, 620));
    renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    renderer.setSize(w, h);
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    ask();
  };
  size();
  first();
  new ResizeObserver(size).observe(host);

  const ray = new Raycaster(), pointer = new Vector2();
  ray.params.Points.threshold = data.point_size;
  let looking = false;
  canvas.addEventListener('pointermove', (e) => {
    if (e.buttons || looking) return;
    looking = true;
    requestAnimationFrame(() => {
      looking = false;
      const r = canvas.getBoundingClientRect();
      pointer.set(((e.clientX - r.left) / r.width) * 2 - 1, 1 - ((e.clientY - r.top) / r.height) * 2);
      ray.setFromCamera(pointer, camera);
      const hit = cloud.visible && ray.intersectObject(cloud)[0];
      label.textContent = hit
        ? `X ${position[3 * hit.index].toFixed(2)}  Y ${position[3 * hit.index + 1].toFixed(2)}  Z ${position[3 * hit.index + 2].toFixed(2)} mm`
        : '';
    });
  });
  canvas.addEventListener('pointerleave', () => { label.textContent = ''; });
  for (const box of panel.querySelectorAll('input[data-layer]')) {
    if (!layers[box.dataset.layer]) { box.closest('label').remove(); continue; }
    box.addEventListener('change', () => { layers[box.dataset.layer].visible = box.checked; ask(); });
  }
  panel.querySelector('select')?.addEventListener('change', (e) => { geometry.setAttribute('color', colours[e.target.value]); legend(e.target.value); ask(); });
  panel.querySelector('button')?.addEventListener('click', () => { first(); ask(); });
  host.dataset.points = String(n);
  host.dataset.ready = 'yes';
  draw();
}

for (const host of document.querySelectorAll('.view-3d')) start(host, JSON.parse(document.getElementById(host.dataset.scene).textContent));
