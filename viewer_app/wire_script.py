"""The page's side of the wire: what a click, a key, a drag and typing in the viewer's own HTML send."""

SCRIPT = """
window.collinea = (() => {
  let count = 0;
  const send = (kind, value) => window.__viserMutable.sendMessage(
    {type: 'GuiUpdateMessage', uuid: UUID, updates: {value: JSON.stringify([kind, value, Date.now() + '-' + count++])}});
  const canvas = () => window.__viserMutable?.canvas;
  const sizes = () => {
    const {clientWidth: width, clientHeight: height} = canvas() ?? {};
    if (width) send('sizes', [width, height, innerWidth, innerHeight].map(v => Math.min(v / 1e4, 1)));
  };
  addEventListener('resize', sizes);
  // how large the canvas is: now, and whenever that changes; asked at any moment it may be what nobody ever sees
  const canvases = new ResizeObserver(sizes);
  const watch = () => {
    canvases.disconnect();
    if (canvas()?.clientWidth) canvases.observe(canvas());
    else setTimeout(watch, 30);
  };
  watch();
  // how wide the photo is drawn, once it rests, and how many pixels of the screen one of the page has
  let photo = null, drawn = '', soon = 0;
  const photoSize = () => {
    const width = photo?.isConnected ? photo.getBoundingClientRect().width : 0, size = width + '/' + devicePixelRatio;
    if (width < 50 || size === drawn) return;
    drawn = size;
    send('photo-size', [width / 1e4, Math.min(devicePixelRatio, 10) / 10]);
  };
  const photos = new ResizeObserver(() => {
    clearTimeout(soon);
    soon = setTimeout(photoSize, 60);
  });
  // the server asks once it knows this browser: what was said before is lost
  const measure = () => {
    watch();
    drawn = '';
    photos.disconnect();
    if (photo) photos.observe(photo);
  };
  const seePhoto = () => {
    const now = document.getElementById('collinea-photo');
    if (now === photo) return;
    photos.disconnect();
    photo = now;
    if (photo) photos.observe(photo);
  };
  // a table wider than its panel says so below itself
  const cut = e => {
    const more = e.nextElementSibling;
    if (more?.dataset.more !== undefined && e.clientWidth) more.hidden = e.scrollWidth <= e.clientWidth + 1;
  };
  const tables = new ResizeObserver(found => found.forEach(f => cut(f.target)));
  const seeTables = () => document.querySelectorAll('[data-wide]').forEach(e => { cut(e); tables.observe(e); });
  const press = ev => { ev.stopPropagation(); const e = ev.currentTarget; send(e.dataset.kind, e.dataset.value); };
  // a button drawn anew between press and release is still the button that was pressed; the page itself makes no click of it
  let held = null;
  const button = ev => ev.target?.closest?.('[data-kind][role=button]');
  document.addEventListener('pointerdown', ev => { held = ev.button === 0 ? button(ev) : null; }, true);
  document.addEventListener('pointerup', ev => {
    const was = held, now = button(ev);
    held = null;
    if (!was || !now || was.isConnected) return;
    const {kind, value} = now.dataset;
    if (was.dataset.kind === kind && was.dataset.value === value) send(kind, value);
  }, true);
  // a slider's keys are its own; keys of commands are not also the camera's, which listens on the document: no step turns it
  const OWN = ['ArrowLeft', 'ArrowRight', 'ArrowUp', 'ArrowDown', 'Home', 'End', 'PageUp', 'PageDown'];
  document.body.addEventListener('keydown', ev => {
    if (OWN.includes(ev.key) && ev.target?.closest?.('[role=slider]')) ev.stopPropagation();
  });
  document.documentElement.addEventListener('keydown', ev => {
    if (['ArrowLeft', 'ArrowRight', 'KeyA'].includes(ev.code)) ev.stopPropagation();
  });
  const find = name => [...document.querySelectorAll('[data-focus]')].find(e => e.dataset.focus === name);
  const step = (e, by) => {
    const row = e.closest('tr'), column = e.dataset.focus?.split('/').slice(0, 2).join('/');
    const next = by > 0 ? row?.nextElementSibling : row?.previousElementSibling;
    const to = next && [...next.querySelectorAll('[data-focus]')].find(f => f.dataset.focus.startsWith(column + '/'));
    if (to) { to.focus(); to.scrollIntoView({block: 'nearest'}); }
    return !!to;
  };
  const arrows = ev => {
    const by = {ArrowDown: 1, ArrowUp: -1}[ev.key];
    if (by && ev.currentTarget.dataset.focus) { ev.preventDefault(); ev.stopPropagation(); step(ev.currentTarget, by); }
  };
  const key = ev => {
    if (ev.key === 'Enter' || ev.key === ' ') { ev.preventDefault(); press(ev); } else arrows(ev);
  };
  // what is typed, the focus and scroll positions outlive the HTML being drawn anew
  const scrolled = {}, typing = {};
  let focus = null, left = 0;  // left: when somebody last went elsewhere
  // a box taken off the page speaks up as one that was left does; only the latter is still there once the page is done
  const ifLeft = (e, then) => queueMicrotask(() => { if (e?.isConnected) then(e); });
  const change = ev => ifLeft(ev.currentTarget, commit);
  const commit = e => {
    if (e.value === e.defaultValue) return;
    delete typing[e.dataset.focus];
    e.defaultValue = e.value;
    send(e.dataset.kind, JSON.stringify([...JSON.parse(e.dataset.value), e.value]));
  };
  const typed = ev => {
    const e = ev.currentTarget;
    ev.stopPropagation();
    if (ev.key === 'Enter') commit(e);
    else if (ev.key === 'Escape') { e.value = e.defaultValue; delete typing[e.dataset.focus]; }
    else arrows(ev);
  };
  document.addEventListener('scroll', ev => {
    const name = ev.target?.dataset?.keep;
    if (name) scrolled[name] = [ev.target.scrollLeft, ev.target.scrollTop];
  }, true);
  document.addEventListener('focusin', ev => { focus = ev.target?.dataset?.focus ?? null; }, true);
  document.addEventListener('pointerdown', ev => {
    left = performance.now();
    if (!ev.target?.closest?.('[data-focus]')) focus = null;
  }, true);
  document.addEventListener('keydown', ev => { if (ev.key === 'Tab') left = performance.now(); }, true);
  document.addEventListener('input', ev => {
    if (ev.target?.dataset?.focus) typing[ev.target.dataset.focus] = ev.target.value;
  }, true);
  document.addEventListener('focusout', ev => ifLeft(ev.target, e => { delete typing[e.dataset?.focus]; }), true);
  new MutationObserver(records => {
    if (!records.some(r => r.addedNodes.length)) return;
    seePhoto();
    seeTables();
    for (const e of document.querySelectorAll('[data-keep]')) {
      const to = scrolled[e.dataset.keep];
      if (to && (e.scrollLeft !== to[0] || e.scrollTop !== to[1])) { e.scrollLeft = to[0]; e.scrollTop = to[1]; }
    }
    if (focus === null || (document.activeElement && document.activeElement !== document.body)) return;
    const name = focus, e = find(name);
    if (!e) return;
    const words = typing[name];
    e.focus({preventScroll: true});
    if (words !== undefined && e.value !== words) { e.value = words; typing[name] = words; }
  }).observe(document.body, {childList: true, subtree: true});
  const clamp = t => Math.min(1, Math.max(0, t));
  const place = (ev, r) => [clamp((ev.clientX - r.left) / r.width), clamp((ev.clientY - r.top) / r.height)];
  // the wheel: at most one message in 60 ms, and none of its turning is lost
  let turned = 0, where = null, resting = false;
  const turn = () => {
    if (Math.abs(turned) < 20) return;
    send(where[0] + (turned < 0 ? '-in' : '-out'), where[1]);
    turned = 0;
    resting = true;
    setTimeout(() => { resting = false; turn(); }, 60);
  };
  const wheel = ev => {
    ev.preventDefault();
    const r = ev.currentTarget.getBoundingClientRect(), {kind} = ev.currentTarget.dataset;
    if (where?.[0] !== kind) turned = 0;
    turned += ev.deltaY;
    where = [kind, [...place(ev, r), clamp(r.width / 10000)]];
    if (!resting) turn();
  };
  const down = ev => {
    if (ev.button > 1) return;
    const pan = ev.shiftKey || ev.button === 1, moved = ev.currentTarget;
    ev.preventDefault();  // with it a browser leaves the focus where it is: a photo takes none, but keys mean it from now on
    document.activeElement?.blur();
    let dragged = false;
    const kind = ev.currentTarget.dataset.kind, r = ev.currentTarget.getBoundingClientRect(), from = place(ev, r);
    let box = null;
    const move = e => {
      const to = place(e, r), far = Math.hypot(e.clientX - ev.clientX, e.clientY - ev.clientY) > 5;
      if (!box && !far) return;
      dragged = true;
      if (pan) {
        moved.style.transform = `translate(${e.clientX - ev.clientX}px,${e.clientY - ev.clientY}px)`;
        return;
      }
      if (!box) {
        box = document.body.appendChild(document.createElement('div'));
        box.style.cssText = 'position:fixed;z-index:10000;pointer-events:none;border:1.5px solid #fff;outline:1.5px dashed #000';
      }
      const at = (i, size, start) => [start + size * Math.min(from[i], to[i]), size * Math.abs(from[i] - to[i])];
      [[box.style.left, box.style.width], [box.style.top, box.style.height]] =
        [at(0, r.width, r.left), at(1, r.height, r.top)].map(p => p.map(v => v + 'px'));
    };
    const up = e => {
      removeEventListener('pointermove', move, true);
      removeEventListener('pointerup', up, true);
      removeEventListener('pointercancel', up, true);
      if (box) box.remove();
      moved.style.transform = '';
      if (e.type !== 'pointerup') return;
      if (dragged) send(kind + (pan ? '-pan' : '-box'), [...from, ...place(e, r)]);
      else if (!pan) send(kind, place(e, r));
    };
    addEventListener('pointermove', move, true);
    addEventListener('pointerup', up, true);
    addEventListener('pointercancel', up, true);
  };
  const named = (kind, words) => [...document.querySelectorAll(kind)].find(e => e.innerText.trim() === words);
  const openTab = tab => {  // tabs listen to the pointer, for they can be dragged
    const opened = named('[role=tab]', tab);
    if (!opened || opened.getAttribute('aria-selected') === 'true') return;
    const r = opened.getBoundingClientRect(), at = {bubbles: true, isPrimary: true, clientX: r.x + 4, clientY: r.y + 4};
    for (const kind of ['pointerdown', 'pointerup']) opened.dispatchEvent(new PointerEvent(kind, at));
  };
  let touched = 0;  // when somebody last did something
  for (const kind of ['pointerdown', 'keydown', 'wheel'])
    document.addEventListener(kind, ev => { if (ev.isTrusted) touched = performance.now(); }, true);
  const open = tabs => {  // as they were left; panels that are still being placed go back to their first tab
    const since = performance.now();
    const again = () => {
      if (touched > since || performance.now() > since + 4000) return;
      tabs.forEach(openTab);
      setTimeout(again, 100);
    };
    again();
  };
  const told = ev => {
    const tab = ev.target?.closest?.('[role=tab]');
    if (tab) send('tab', tab.innerText.trim());
  };
  document.addEventListener('pointerup', told, true);
  document.addEventListener('keyup', told, true);
  const reach = (tab, label, until = null) => {  // a box to type in gets the focus, a button is pressed
    if (document.querySelector('[role=dialog]')) {  // the palette is still closing
      requestAnimationFrame(() => reach(tab, label));
      return;
    }
    until ??= performance.now() + 3000;
    openTab(tab);
    let row = named('label', label);
    while (row && !row.querySelector('input, textarea')) row = row.parentElement;
    const box = row?.querySelector('input, textarea');
    const to = box ?? named('button', label), soon = performance.now() < until;
    if (!to || (soon && to.offsetParent === null)) {
      if (soon) requestAnimationFrame(() => reach(tab, label, until));
      return;
    }
    if (!box) { to.click(); return; }
    box.focus();
    box.select();
    // the palette gives the focus back to where it was, however long after it has gone: only a person takes it away
    const since = performance.now(), done = new AbortController(), {signal} = done;
    const back = () => queueMicrotask(() => {
      if (left > since || !box.isConnected) done.abort();
      else box.focus();
    });
    box.addEventListener('keydown', () => done.abort(), {signal});
    box.addEventListener('blur', back, {signal});
  };
  return {send, press, key, change, typed, down, wheel, reach, open, measure};
})();
"""
