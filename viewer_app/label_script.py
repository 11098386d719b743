"""The page's side of words in the scene: boxes that follow the theme, names that make room for each other, words never hidden.

viser draws all labels as quads in two layers of one group, black on white. Before each picture the page dresses these two layers
in the theme's colours and says which labels are drawn:

- words (anchored elsewhere than at their foot: scale bars, exaggerations, north) always are, and slide about as far as their own
  size to stay on the canvas, clear of the panels that lie over it and of each other, the longer ones round the shorter;
- a name that would lie over words, or over a name that is larger or comes before it whatever one looks from, stands left of its
  place or below, or is not shown; where it stands it stays as long as it can, and comes back only when it has a little room to
  spare, so that nothing flickers while the camera moves.

Where viser draws its labels in another way, nothing of this is done, and labels stay what viser makes of them.

A picture that is asked of the page (`get_render`) reaches as far as the page itself: viser would end it after 1000 m.
"""

import json

from .theme import foreground

LOOK = {"light": ([1.0, 1.0, 1.0, 0.85], foreground(False)), "dark": ([0.09, 0.1, 0.11, 0.8], foreground(True))}
"""Red, green, blue and opacity of the box, and the words' colour, by theme."""

SCRIPT = """
window.collineaLabels?.stop();
window.collineaLabels = (() => {
  const BOX = 10001, TEXT = 10002, GONE = 2 ** -20, RIM = 4, SPARE = 5, CELL = 96;
  const LOOK = LOOKS;
  const ink = {value: [0, 0, 0]}, paper = {value: [1, 1, 1, 0.85]};
  let group = null, drawn = [], panels = [], looked = 0;
  const stands = new Map();  // where each name stands of the spots it may have, -1: nowhere
  const moved = new Map();  // where viser had the labels that were moved, and where they are now
  const find = scene => {
    let found = null;
    scene.traverse(o => { if (!found && o.renderOrder === BOX && o.material?.uniforms?.uLabelData) found = o.parent; });
    return found;
  };
  const dress = mesh => {
    const m = mesh.material;
    if (m.collinea || !m.isShaderMaterial) return;
    m.collinea = true;
    const box = mesh.renderOrder === BOX;
    const [from, to] = box ? ['vec4(1.0, 1.0, 1.0, 0.85 * vAlpha)', 'vec4(uPaper.rgb, uPaper.a * vAlpha)']
                           : ['vec4(0.0, 0.0, 0.0, a)', 'vec4(uInk, a)'];
    if (!m.fragmentShader.includes(from)) return;
    m.fragmentShader = (box ? 'uniform vec4 uPaper;\\n' : 'uniform vec3 uInk;\\n') + m.fragmentShader.replace(from, to);
    m.uniforms[box ? 'uPaper' : 'uInk'] = box ? paper : ink;
    m.needsUpdate = true;
  };
  const theme = () => {
    const name = document.documentElement.getAttribute('data-mantine-color-scheme') === 'dark' ? 'dark' : 'light';
    paper.value = LOOK[name][0];
    ink.value = LOOK[name][1].map(v => v / 255);
  };
  const covered = canvas => {  // rectangles of the panels over the canvas, from its top left
    if (performance.now() < looked + 250) return;
    looked = performance.now();
    const c = canvas.getBoundingClientRect();
    panels = [...document.querySelectorAll('.mantine-Paper-root')].map(e => e.getBoundingClientRect())
      .filter(r => r.width && r.right > c.left + 1 && r.left < c.right - 1 && r.bottom > c.top + 1 && r.top < c.bottom - 1)
      .map(r => [r.left - c.left, r.top - c.top, r.right - c.left, r.bottom - c.top]);
  };
  const apart = (a, b, by) => a[2] + by <= b[0] || b[2] + by <= a[0] || a[3] + by <= b[1] || b[3] + by <= a[1];
  const labels = (data, f, aspect, u) => {  // those in front of the camera, with their boxes in pixels of the page
    const found = [], {P, V, H} = f;
    for (const mesh of group.children) {
      if (mesh.renderOrder !== BOX) continue;
      const {aLabelIndex: index, aRect: rect, aParams: params} = mesh.geometry.attributes;
      if (!index) continue;
      for (let k = 0; k < mesh.geometry.instanceCount; k++) {
        const n = index.array[k], at = 4 * n, was = moved.get(n);
        if (was && was.to.every((v, i) => v === data[at + i])) data.set(was.from, at);
        if (data[at + 3] === GONE) data[at + 3] = 1;
        if (!data[at + 3] || !params.array[2 * k]) continue;
        const [x, y, z] = [0, 1, 2].map(i => V[i] * data[at] + V[4 + i] * data[at + 1] + V[8 + i] * data[at + 2] + V[12 + i]);
        if (z > -1e-9) continue;
        const s = params.array[2 * k + 1] / 10 * u.uFovScale.value * 400 * P[5];
        const px = H / 2 * (aspect + P[0] * aspect * x / -z), py = H / 2 * (1 - P[5] * y / -z);
        const [l, b, w, h] = [0, 1, 2, 3].map(i => s * rect.array[4 * k + i]);
        const box = [px + l, py - b - h, px + l + w, py - b];
        found.push({n, at, box, em: h, words: Math.abs(b) > 0.05 * h, depth: -z, key: [data[at], data[at + 1], data[at + 2]]});
      }
    }
    return found;
  };
  const slide = (box, taken, size, blocked) => {  // the shortest way on the canvas, off the panels and off what is taken
    const [w, h] = [box[2] - box[0], box[3] - box[1]], keep = (v, most) => Math.min(Math.max(v, RIM), most - RIM);
    const on = (x, y) => [keep(x, size[0] - w), keep(y, size[1] - h)];
    const free = (x, y) => [...blocked, ...taken].every(b => apart([x, y, x + w, y + h], b, 1));
    let tried = [on(box[0], box[1])];
    for (let turn = 0; turn < 3; turn++) {
      const good = tried.filter(p => free(...p)).map(p => [Math.hypot(p[0] - box[0], p[1] - box[1]), ...p]);
      good.sort((a, b) => a[0] - b[0]);
      if (good.length) return good[0][0] <= w + 2 * h ? good[0].slice(1) : null;
      const next = [];
      for (const [x, y] of tried.slice(0, 12)) for (const b of [...blocked, ...taken]) {
        if (apart([x, y, x + w, y + h], b, 1)) continue;
        next.push(on(b[2] + 2, y), on(b[0] - w - 2, y), on(x, b[1] - h - 2), on(x, b[3] + 2));
      }
      tried = next;
    }
    return null;
  };
  const place = (scene, camera) => {
    const page = window.__viserMutable, u = group.children[0].material.uniforms, data = u.uLabelData.value.image.data;
    const V = camera.matrixWorldInverse.elements, P = camera.projectionMatrix.elements, H = u.uViewportHeight.value;
    const aspect = P[5] / P[0], size = [H * aspect, H], own = camera === page.camera;
    if (own) covered(page.canvas);
    const all = labels(data, {P, V, H}, aspect, u), grid = new Map(), taken = [], blocked = own ? panels : [];
    const cells = (b, by, act) => {
      for (let i = Math.floor((b[0] - by) / CELL); i <= Math.floor((b[2] + by) / CELL); i++)
        for (let j = Math.floor((b[1] - by) / CELL); j <= Math.floor((b[3] + by) / CELL); j++)
          if (act(`${i},${j}`) === false) return false;
      return true;
    };
    const take = b => cells(b, 0, c => { (grid.get(c) ?? grid.set(c, []).get(c)).push(b); });
    const room = (b, by) => cells(b, by, c => (grid.get(c) ?? []).every(o => apart(b, o, by)));
    const order = (a, b) => b.words - a.words || (b.em - a.em) * (a.words ? -1 : 1)
      || a.key[0] - b.key[0] || a.key[1] - b.key[1] || a.key[2] - b.key[2];
    const shift = (b, d) => [b[0] + d[0], b[1] + d[1], b[2] + d[0], b[3] + d[1]];
    const put = (one, d) => {  // as far to the camera's right and up, at the same depth
      if (d[0] || d[1]) {
        const per = 2 * one.depth / (H * P[5]), from = [...data.subarray(one.at, one.at + 3)];
        for (let i = 0; i < 3; i++) data[one.at + i] += per * (d[0] * V[4 * i] - d[1] * V[4 * i + 1]);
        moved.set(one.n, {from, to: [...data.subarray(one.at, one.at + 3)]});
        one.box = shift(one.box, d);
      }
      take(one.box);
      now.push({...one, shown: true});
    };
    const beside = box => {  // where a name may stand: at its place, left of it, below, both
      const w = box[0] - box[2] - 10, h = box[3] - box[1] + 8;
      return [[0, 0], [w, 0], [0, h], [w, h]];
    };
    moved.clear();
    const now = [];
    for (const one of all.sort(order)) {
      if (one.words) {
        const to = slide(one.box, taken, size, blocked);
        put(one, to ? [to[0] - one.box[0], to[1] - one.box[1]] : [0, 0]);
        taken.push(one.box);
        continue;
      }
      if (one.box[2] < 0 || one.box[0] > size[0] || one.box[3] < 0 || one.box[1] > size[1]) continue;
      const spots = beside(one.box), was = stands.get(one.n) ?? 0;
      const fits = (k, by) => room(shift(one.box, spots[k]), by);
      let k = was > 0 && fits(0, 4 * SPARE) ? 0 : was >= 0 && fits(was, 0) ? was : -1;
      if (k < 0) k = [0, 1, 2, 3].findIndex(i => fits(i, SPARE));
      stands.set(one.n, k);
      if (k >= 0) { put(one, spots[k]); continue; }
      data[one.at + 3] = GONE;
      now.push({...one, shown: false});
    }
    if (own) drawn = now;
    u.uLabelData.value.needsUpdate = true;
  };
  const reach = camera => {  // a picture that was asked for ends where the page does, not after viser's 1000 m
    const own = window.__viserMutable?.camera;
    if (!own || camera === own || !camera.isPerspectiveCamera || camera.far === own.far) return;
    [camera.near, camera.far] = [own.near, own.far];
    camera.updateProjectionMatrix();
  };
  let broken = false;
  const before = (renderer, scene, camera) => {
    reach(camera);
    if (broken) return;
    try {
      if (!group?.parent || !group.children.length) group = find(scene);
      if (!group) return;
      theme();
      group.children.forEach(dress);
      place(scene, camera);
    } catch (error) {  // another viser: as it draws them
      broken = true;
      console.warn('collinea: labels stay as they are', error);
    }
  };
  const hook = () => {
    const scene = window.__viserMutable?.scene;
    if (scene && scene.onBeforeRender !== before) {
      scene.onBeforeRender = before;
      window.__viserMutable.requestRender();
    }
  };
  const timer = setInterval(hook, 200);
  hook();
  const again = new MutationObserver(() => window.__viserMutable?.requestRender());
  again.observe(document.documentElement, {attributes: true, attributeFilter: ['data-mantine-color-scheme']});
  return {
    drawn: () => drawn.map(({box, em, words, shown}) => ({box, em, words, shown})), panels: () => panels,
    works: () => !!group && !broken,
    stop: () => { clearInterval(timer); again.disconnect(); broken = true; }
  };
})();
""".replace("LOOKS", json.dumps(LOOK))
