// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// The Allan deviation of one sensor: curves with limits, the selected model, and the parts of the
// model of the curve nearest to the cursor. Color is the axis, dashes and a letter are the term.
'use strict';

const AllanChart = (() => {
  const { color, element, number } = Chart;
  const DASHES = { Q: [1, 3], N: [8, 3], B: [9, 3, 2, 3], K: [14, 4], R: [4, 3, 1, 3, 1, 3] };
  const PROCESS = [2, 4];
  const LIMIT = [1, 5];
  const REFERENCE = [[2, 2], [6, 2], [1, 4]];
  const STRIP = 15;
  // The flat part of the curve is at 0.664 B: the label states this, because the table contains B.
  const caption = (term, likely = []) => (term === 'B' ? '0.664 B' : term) + (likely.includes(term) ? '?' : '');
  const isTerm = (name) => name in DASHES;

  // A marker of an axis, so that axes differ in shape as well as in color.
  function mark(context, label, x, y, size) {
    context.beginPath();
    if (label === 'x') context.arc(x, y, size, 0, 2 * Math.PI);
    else if (label === 'y') context.rect(x - 0.9 * size, y - 0.9 * size, 1.8 * size, 1.8 * size);
    else {
      context.moveTo(x, y - 1.2 * size);
      context.lineTo(x + 1.1 * size, y + 0.8 * size);
      context.lineTo(x - 1.1 * size, y + 0.8 * size);
      context.closePath();
    }
  }

  function create(host, sensor, units) {
    const axes = sensor.axes.filter((a) => a.adev);
    const shown = new Set([...axes.map((a) => a.label), 'fit', 'limits', 'upper', 'Q', 'N', 'B', 'K', 'R', 'other', 'references']);
    let system = units;
    let near = axes[0];
    let occupied = [];
    const unit = () => sensor.units[system].curve;
    const scaled = (values) => values.map((v) => (v === null ? null : v * unit()[1]));
    const columns = () => [sensor.tau, ...axes.flatMap((a) => [scaled(a.low), scaled(a.high), scaled(a.fit), scaled(a.adev), scaled(a.most)])];
    const visible = () => axes.filter((a) => shown.has(a.label));

    const series = axes.flatMap((a) => [
      { label: `${a.label} low`, width: 0, points: { show: false } },
      { label: `${a.label} high`, width: 0, points: { show: false } },
      { label: `${a.label} fit`, stroke: () => color(a.label), width: 1.6, points: { show: false } },
      { label: a.label, bare: true, paths: () => null, points: { show: false } },
      { label: `${a.label} at limits`, width: 0, points: { show: false } },
    ]);
    const bands = axes.flatMap((a, i) => [
      { series: [5 * i + 2, 5 * i + 1], fill: () => color(`${a.label}-faint`) },
      { series: [5 * i + 5, 5 * i + 3], fill: () => color(`${a.label}-band`) },
    ]);

    // The complete range: all visible curves, and the marks slightly below them.
    function rangeY() {
      const some = visible().length ? visible() : axes;
      const values = some.flatMap((a) => scaled(a.adev)).filter((v) => v > 0);
      if (!values.length) return [0.1, 10];
      const low = Math.min(...values);
      const marks = some.flatMap((a) => Object.values(a.read).map(([, v]) => v * unit()[1])).filter((v) => v > 0.2 * low);
      return [Math.min(0.45 * low, ...marks.map((v) => 0.75 * v)), 1.7 * Math.max(...values)];
    }
    const rangeX = () => [sensor.tau[0] / 1.25, sensor.tau[sensor.tau.length - 1] * 1.35];

    function line(u, values, dash, width, ink) {
      const { ctx } = u;
      ctx.save();
      ctx.beginPath();
      ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      ctx.clip();
      ctx.beginPath();
      let open = false;
      values.forEach((v, i) => {
        if (!(v > 0)) { open = false; return; }
        const x = u.valToPos(sensor.tau[i], 'x', true);
        const y = u.valToPos(v * unit()[1], 'y', true);
        if (open) ctx.lineTo(x, y);
        else ctx.moveTo(x, y);
        open = true;
      });
      ctx.setLineDash(dash.map((d) => d * devicePixelRatio));
      ctx.lineWidth = width * devicePixelRatio;
      ctx.strokeStyle = ink;
      ctx.stroke();
      ctx.restore();
    }

    function text(u, words, x, y, ink, align = 'center') {
      const { ctx } = u;
      ctx.save();
      ctx.font = `600 ${12 * devicePixelRatio}px system-ui, sans-serif`;
      ctx.textAlign = align;
      ctx.textBaseline = 'middle';
      ctx.lineWidth = 4 * devicePixelRatio;
      ctx.lineJoin = 'round';
      ctx.strokeStyle = color('paper');
      ctx.strokeText(words, x, y);
      ctx.fillStyle = ink;
      ctx.fillText(words, x, y);
      ctx.restore();
    }

    // A cross where the coefficient is read as in IEEE Std 952 (N at 1 s, K at 3 s), if it is in the
    // picture. The letter is next to it, or else where the line enters or leaves the picture.
    function letter(u, term, values, ink) {
      const ratio = devicePixelRatio;
      const [x, y] = term in near.read ? at(u, ...near.read[term]) : [NaN, NaN];
      if (inside(u, x, y)) {
        const { ctx } = u;
        ctx.beginPath();
        ctx.moveTo(x - 6 * ratio, y);
        ctx.lineTo(x + 6 * ratio, y);
        ctx.moveTo(x, y - 6 * ratio);
        ctx.lineTo(x, y + 6 * ratio);
        ctx.setLineDash([]);
        ctx.lineWidth = 2 * ratio;
        ctx.strokeStyle = ink;
        ctx.stroke();
        const seconds = number(near.read[term][0], 1);
        label(u, `${term} at ${seconds} s`, [[x - 8 * ratio, y + 16 * ratio], [x + 8 * ratio, y - 16 * ratio]], ink, 'right');
        return;
      }
      const run = places(u, values);
      if (!run.length) return;
      const rising = run[0][1] > run[run.length - 1][1] + 2;
      const ends = rising ? [run[0], run[run.length - 1]] : [run[run.length - 1], run[0]];
      const up = ends.flatMap(([ex, ey]) => [[ex, ey - 11 * ratio], [ex, ey + 11 * ratio]]);
      label(u, caption(term, near.likely), up, ink, 'center');
    }

    // A label at the first of its possible places that is free.
    function label(u, words, spots, ink, align) {
      const { ctx, bbox } = u;
      const ratio = devicePixelRatio;
      ctx.font = `600 ${12 * ratio}px system-ui, sans-serif`;
      const wide = ctx.measureText(words).width;
      for (const [px, y] of spots) {
        const center = align === 'right' ? px - wide / 2 : px;
        const x = Math.min(Math.max(center, bbox.left + wide / 2 + 3 * ratio), bbox.left + bbox.width - wide / 2 - 3 * ratio);
        if (y < bbox.top + 8 * ratio || y > bbox.top + bbox.height - 8 * ratio) continue;
        if (occupied.some(([ox, oy, ow]) => Math.abs(ox - x) < (ow + wide) / 2 + 4 * ratio && Math.abs(oy - y) < 15 * ratio)) continue;
        occupied.push([x, y, wide]);
        text(u, words, x, y, ink);
        return;
      }
    }

    const at = (u, tau, v) => [u.valToPos(tau, 'x', true), u.valToPos(v * unit()[1], 'y', true)];
    const inside = (u, x, y) => x >= u.bbox.left && x <= u.bbox.left + u.bbox.width && y >= u.bbox.top && y <= u.bbox.top + u.bbox.height;

    // The name of a line is next to it: where one of the heights, in pixels below the line, is
    // farthest from all curves within so many pixels to the left and right.
    function name(u, words, values, heights, width) {
      const ratio = devicePixelRatio;
      const curves = visible().flatMap((a) => places(u, a.adev));
      const spots = places(u, values).flatMap(([x, y]) => heights.map((down) => [x, y + down * ratio])).map(([x, y]) => {
        const near = curves.filter(([ox]) => Math.abs(ox - x) < width * ratio).map(([, oy]) => Math.abs(oy - y));
        return [Math.min(0.8 * width * ratio, ...near), x, y];
      });
      spots.sort((a, b) => b[0] - a[0]);
      label(u, words, spots.map(([, x, y]) => [x, y]), color('ink-2'), 'center');
    }

    // The part of a line that is in the picture.
    const places = (u, values) => values
      .map((v, i) => [u.valToPos(sensor.tau[i], 'x', true), v > 0 ? u.valToPos(v * unit()[1], 'y', true) : NaN])
      .filter(([x, y]) => x >= u.bbox.left && x <= u.bbox.left + u.bbox.width && y > u.bbox.top + 8 && y < u.bbox.top + u.bbox.height - 8);

    function above(u) {
      const { ctx } = u;
      const ratio = devicePixelRatio;
      occupied = [];
      const references = sensor.references.filter((r) => r.axis === near.name && shown.has('references'));
      const drawn = shown.has(near.label) ? Object.entries(near.parts).filter(([name]) => shown.has(isTerm(name) ? name : 'other')) : [];
      if (shown.has(near.label)) {
        if (shown.has('upper')) for (const values of Object.values(near.upper)) line(u, values, LIMIT, 1, color(near.label));
        references.forEach((other, i) => line(u, other.adev, REFERENCE[i % REFERENCE.length], 1.4, color('ink-2')));
        for (const [term, values] of drawn) line(u, values, DASHES[term] || PROCESS, 1.2, color(near.label));
      }
      for (const a of visible()) {
        ctx.lineWidth = 1.3 * ratio;
        ctx.strokeStyle = color(a.label);
        ctx.fillStyle = color('paper');
        a.adev.forEach((v, i) => {
          if (!(v > 0)) return;
          const x = u.valToPos(sensor.tau[i], 'x', true);
          const y = u.valToPos(v * unit()[1], 'y', true);
          if (x < u.bbox.left || x > u.bbox.left + u.bbox.width || y < u.bbox.top || y > u.bbox.top + u.bbox.height) return;
          mark(ctx, a.label, x, y, 2.6 * ratio);
          ctx.fill();
          ctx.stroke();
        });
      }
      for (const [term, values] of drawn) letter(u, term, values, color(near.label));
      if (shown.has(near.label) && shown.has('upper')) for (const [term, values] of Object.entries(near.upper)) name(u, `${term} limit`, values, [14, 34, 60], 30);
      if (shown.has(near.label)) references.forEach((other) => name(u, other.name, other.adev, [-14, 14], 50));
      visible().forEach((a, row) => strip(u, a, row));
    }

    // Above the picture, a strip for each axis shows which part of the model dominates.
    function strip(u, a, row) {
      const { ctx } = u;
      const ratio = devicePixelRatio;
      const top = u.bbox.top - (axes.length - row) * STRIP * ratio - 4 * ratio;
      const left = u.bbox.left;
      const right = left + u.bbox.width;
      ctx.save();
      text(u, a.label, left - 10 * ratio, top + STRIP * ratio / 2, color(a.label), 'right');
      (a.regions || []).forEach(([low, high, term], i) => {
        const from = Math.max(left, u.valToPos(low, 'x', true));
        const to = Math.min(right, u.valToPos(high, 'x', true));
        if (to <= from) return;
        ctx.fillStyle = color(`${a.label}-${i % 2 ? 'tint' : 'faint'}`);
        ctx.fillRect(from, top, to - from - ratio, (STRIP - 2) * ratio);
        ctx.font = `600 ${11 * ratio}px system-ui, sans-serif`;
        // the label of a narrow part contains only the kinds of its processes
        const kinds = term.replace(/ [^+]*/g, '');
        const words = [term, kinds].find((text) => ctx.measureText(text).width + 4 * ratio < to - from);
        if (!words) return;
        ctx.fillStyle = color('ink');
        ctx.textAlign = 'center';
        ctx.textBaseline = 'middle';
        ctx.fillText(words, (from + to) / 2, top + (STRIP - 1) * ratio / 2);
      });
      ctx.restore();
    }

    // The parts of the axis whose curve is nearest to the cursor are drawn.
    function focus(u, at) {
      let best = Infinity;
      let found = near;
      for (const a of visible()) {
        if (!(a.adev[at] > 0)) continue;
        const distance = Math.abs(u.valToPos(a.adev[at] * unit()[1], 'y') - u.cursor.top);
        if (distance < best) { best = distance; found = a; }
      }
      if (found !== near) {
        near = found;
        showAxis();
        u.redraw(false, false);
      }
    }

    function describe(u, at) {
      const [name, factor] = unit();
      const lines = [[`τ ${number(sensor.tau[at])} s`, null]];
      for (const a of visible()) {
        if (!(a.adev[at] > 0)) continue;
        lines.push([`${a.label}  ${number(a.adev[at] * factor)} ${name}  (${number(a.low[at] * factor, 3)}..${number(a.high[at] * factor, 3)})`, color(a.label)]);
      }
      if (shown.has(near.label)) {
        const parts = Object.entries(near.parts)
          .filter(([term, values]) => shown.has(isTerm(term) ? term : 'other') && values[at] > 0)
          .map(([term, values]) => `${caption(term, near.likely)} ${number(values[at] * factor, 3)}`);
        if (parts.length) lines.push([`model of ${near.label}: ${parts.join(', ')}`, null]);
        const region = (near.regions || []).find(([low, high]) => sensor.tau[at] >= low && sensor.tau[at] <= high);
        if (region) lines.push([`${region[2]} dominates ${near.label} here, slope ${region[3] < 0 ? '−' : '+'}${Math.abs(region[3]).toFixed(2)}`, null]);
        if (near.n[at]) lines.push([`${near.n[at].toLocaleString('en')} differences`, null]);
      }
      return lines;
    }

    const heading = element('h3', {}, 'Allan deviation');
    const parts = element('span', {});
    const axisName = () => `Allan deviation σ(τ) [${unit()[0]}]`;
    const showAxis = () => { parts.textContent = `Parts of the model are drawn for ${near.label}`; };
    const controls = element('div', { class: 'controls' });
    host.append(heading, controls);
    const u = Chart.create(host, {
      label: `Allan deviation of the ${sensor.sensor}; arrow keys move from point to point`,
      height: 462,
      padding: [axes.length * STRIP + 12, 14, 0, 0],
      zoomY: true,
      x: { log: true, full: rangeX, label: 'averaging time τ [s]' },
      y: { log: true, full: rangeY, label: axisName() },
      series, bands, above, focus, describe,
    }, columns());

    function change(key, on) {
      if (on) shown.add(key);
      else shown.delete(key);
      axes.forEach((a, i) => {
        const there = shown.has(a.label);
        const limits = there && shown.has('limits');
        const model = there && shown.has('fit');
        [limits, limits, model, there, model && shown.has('upper')].forEach((state, j) => u.setSeries(5 * i + 1 + j, { show: state }));
      });
      if (!shown.has(near.label) && visible().length) [near] = visible();
      showAxis();
      u.setData(columns());
    }
    const terms = [...new Set(axes.flatMap((a) => Object.keys(a.parts)))];
    const others = [{ key: 'fit', text: 'model' }, { key: 'limits', text: '68 % limits' }];
    if (axes.some((a) => Object.keys(a.upper).length)) others.push({ key: 'upper', text: 'limits of unresolved terms', dash: LIMIT });
    if (terms.some((t) => !isTerm(t))) others.push({ key: 'other', text: 'processes', dash: PROCESS });
    if (sensor.references.length) others.push({ key: 'references', text: [...new Set(sensor.references.map((r) => r.name))].join(', '), dash: REFERENCE[0] });
    const title = () => `${heading.dataset.sensor}: Allan deviation`;
    heading.dataset.sensor = sensor.title;
    heading.append(Chart.element('span', { class: 'grow' }), Picture.buttons(u, title, `allan_${sensor.sensor}`));
    u.title = title();
    controls.append(
      Chart.toggles('axes', axes.map((a) => ({ key: a.label, text: a.label, style: `var(--${a.label})` })), change),
      Chart.toggles('parts', Object.keys(DASHES).filter((t) => terms.includes(t)).map((t) => ({ key: t, text: caption(t), dash: DASHES[t] })), change),
      Chart.toggles('also', others, change),
    );
    const note = ['The strips above the chart show which part of the model dominates; crosses mark where coefficients are read. '];
    if (axes.some((a) => a.likely.length)) note.push('"?": likely but not resolved. ');
    if (axes.some((a) => Object.keys(a.upper).length)) note.push('Shaded: possible contribution of unresolved terms, up to the 95\u00a0% upper limits (dotted). ');
    host.append(element('p', { class: 'note' }, ...note, parts, element('span', { class: 'hint' }, ', the curve nearest to the cursor. Drag to zoom, double-click to go back'), '.'));
    showAxis();
    return {
      units(next) {
        system = next;
        u.axes[1].label = axisName();
        showAxis();
        u.setData(columns());
      },
    };
  }

  return { create };
})();
