// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// Inserts the charts into the page, and provides the switch of units, copying and printing.
'use strict';

(() => {
  const { element } = Chart;
  const data = JSON.parse(document.getElementById('data').textContent);
  const PRINTED = { 1: 700, 2: 342 };  // width in pixels of a chart on A4, by the number of columns
  const FLATTER = 0.8;  // height of a printed chart, relative to the screen
  const page = { ...data, units: () => (document.querySelector('input[name=units]:checked') || { value: data.units }).value };

  for (const host of document.querySelectorAll('.charts[data-kind]')) {
    const sensor = data.sensors.find((s) => s.sensor === host.dataset.sensor);
    if (sensor) Charts[host.dataset.kind](host, sensor, page);
    else Charts[host.dataset.kind](host, page);
  }
  for (const host of document.querySelectorAll('.copy')) copyButtons(host, data.sensors.find((s) => s.sensor === host.dataset.sensor));

  for (const input of document.querySelectorAll('input[name=units]')) {
    input.addEventListener('change', () => Chart.all.forEach((chart) => { if (chart.note) chart.note(); chart.render(); }));
  }

  function copyButtons(host, sensor) {
    const status = element('span', { role: 'status' });
    const offers = { coefficients: () => sensor.copy[page.units()], curve: () => curve(sensor) };
    host.append('copy as table');
    for (const [what, text] of Object.entries(offers)) {
      const button = element('button', { type: 'button' }, what);
      button.addEventListener('click', async () => {
        status.textContent = (await copy(text())) ? `${what} copied` : 'the browser does not allow it';
      });
      host.append(button);
    }
    host.append(status);
    host.hidden = false;
  }

  // The curve of all axes in SI, a line for each averaging time.
  function curve(sensor) {
    const axes = sensor.axes.filter((a) => a.adev);
    const head = ['tau_s', ...axes.flatMap((a) => ['adev', 'low68', 'high68', 'n'].map((what) => `${a.name}_${what}`))];
    const rows = sensor.tau.map((tau, i) => [tau, ...axes.flatMap((a) => [a.adev[i], a.low[i], a.high[i], a.n[i]])]);
    return [head, ...rows].map((row) => row.map((v) => (v === null ? '' : v)).join('\t')).join('\n') + '\n';
  }

  async function copy(text) {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {
      // A page from a file, or an older browser: through a selection.
      const area = element('textarea', { class: 'spoken', 'aria-hidden': 'true' });
      area.value = text;
      document.body.append(area);
      area.select();
      const done = document.execCommand('copy');
      area.remove();
      return done;
    }
  }

  // In print, all parts are open, and charts are drawn anew for the width of the paper.
  const closed = [];
  addEventListener('beforeprint', () => {
    document.documentElement.classList.add('printing');
    closed.push(...document.querySelectorAll('details:not([open])'));
    for (const part of closed) part.open = true;
    for (const chart of Chart.all) {
      const columns = chart.box.closest('.pair') ? data.sensors.length : 1;
      chart.render(PRINTED[columns], FLATTER * chart.spec.height);
    }
  });
  addEventListener('afterprint', () => {
    document.documentElement.classList.remove('printing');
    for (const part of closed.splice(0)) part.open = false;
    for (const chart of Chart.all) chart.render();
  });
})();
