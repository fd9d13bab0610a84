// Copyright 2026 the allan_ros authors
// SPDX-License-Identifier: Apache-2.0
// Puts the charts into the page, and lets one switch units, copy and print.
'use strict';

(() => {
  const { element } = Chart;
  const data = JSON.parse(document.getElementById('data').textContent);
  const charts = [];
  const chosen = () => (document.querySelector('input[name=units]:checked') || { value: data.units }).value;

  document.documentElement.classList.add('scripted');
  for (const sensor of data.sensors) {
    if (sensor.axes.some((a) => a.adev && a.adev.some((v) => v > 0))) {
      const place = (kind, where) => {
        const host = document.querySelector(`.charts.${where}[data-sensor=${sensor.sensor}]`);
        const made = element('div', { class: `chart ${kind}` });
        host.hidden = false;
        host.append(made);
        return made;
      };
      charts.push(AllanChart.create(place('allan', 'curve'), sensor, chosen()));
      if (sensor.signal) {
        charts.push(OtherCharts.signal(place('signal', 'rest'), sensor, chosen(), data.warmth));
        const { time } = sensor.signal;
        if (data.warmth) OtherCharts.temperature(place('warmth', 'rest'), data.warmth, time[time.length - 1]);
      }
      if (sensor.spectrum) charts.push(OtherCharts.spectrum(place('spectrum', 'rest'), sensor, chosen()));
    }
    copyButtons(document.querySelector(`.copy[data-sensor=${sensor.sensor}]`), sensor);
  }

  for (const input of document.querySelectorAll('input[name=units]')) {
    input.addEventListener('change', () => charts.forEach((chart) => chart.units(chosen())));
  }

  function copyButtons(host, sensor) {
    const said = element('span', { role: 'status' });
    host.append(element('span', {}, 'copy as'));
    const offers = { ...Object.fromEntries(Object.keys(sensor.copy[data.units]).map((form) => [form, () => sensor.copy[chosen()][form]])), 'curve (TSV)': () => curve(sensor) };
    for (const [form, text] of Object.entries(offers)) {
      const button = element('button', { type: 'button' }, form);
      button.addEventListener('click', async () => {
        said.textContent = (await copy(text())) ? `${form} copied` : 'the browser does not allow it';
      });
      host.append(button);
    }
    host.append(said);
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

  // Paper is white, and shows what is folded.
  addEventListener('beforeprint', () => {
    document.documentElement.classList.add('printing');
    for (const folded of document.querySelectorAll('details:not([open])')) {
      folded.open = true;
      folded.dataset.folded = '';
    }
    Chart.redrawAll();
  });
  addEventListener('afterprint', () => {
    document.documentElement.classList.remove('printing');
    for (const folded of document.querySelectorAll('details[data-folded]')) folded.open = false;
    Chart.redrawAll();
  });
})();
