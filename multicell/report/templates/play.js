"use strict";
const token = new URLSearchParams(location.search).get("token");
const at = (path, more = "") => `${path}?token=${encodeURIComponent(token)}${more}`;
const find = (name) => document.querySelector(name);
const sliders = JSON.parse(find("#about").textContent);
const inputs = [...document.querySelectorAll(".play input")];
const status = find("#status"), done = find("progress"), stop = find("#stop");
const say = (text) => { if (status.textContent !== text) status.textContent = text; };

function write(k) {
  const { low, high, log, whole, unit } = sliders[k], share = inputs[k].value / 1000;
  let value = log ? low * (high / low) ** share : low + share * (high - low);
  if (whole) value = Math.min(Math.floor(log ? low * ((high + 1) / low) ** share : low + share * (high + 1 - low)), high);
  const words = `${Number(value.toPrecision(3))} ${unit}`.trim();
  inputs[k].previousElementSibling.textContent = words;
  inputs[k].setAttribute("aria-valuetext", words);
}

const night = matchMedia("(prefers-color-scheme: dark)");
let shown = "", asked = 0, loading = false;
async function look() {
  let run;
  try {
    run = await (await fetch(at("/run"))).json();
  } catch {
    say("The server has ended: start it anew with multicell play.");
    return;
  }
  say(run.text || "Move a slider, or run the scene as it is.");
  done.value = run.part;
  stop.disabled = !run.going;
  const state = `${run.number} ${run.frames} ${run.going}`;
  // a view that is complete at once; while a run goes on one every three seconds
  if (run.frames > 1 && state !== shown && !loading && (!run.going || Date.now() - asked > 3000)) {
    shown = state;
    asked = Date.now();
    await draw();
  }
  setTimeout(look, run.going ? 700 : 2000);
}

async function draw() {
  const next = find("iframe.next"), old = find("iframe:not(.next)");
  loading = true;
  next.onload = () => {
    const before = old.contentWindow.multicellViewer && old.contentDocument.querySelector('[data-part="colour"]');
    const after = next.contentDocument.querySelector('[data-part="colour"]');
    if (before && after && before.value) { after.value = before.value; after.dispatchEvent(new Event("change")); }
    for (const [frame, off] of [[next, false], [old, true]]) {
      frame.classList.toggle("next", off);
      frame.ariaHidden = off ? "true" : null;
      frame.tabIndex = off ? -1 : 0;
    }
    const body = next.contentDocument.body; // grows when curves and legend have been drawn
    next.contentDocument.querySelector("footer").hidden = true;
    new next.contentWindow.ResizeObserver(() => { next.parentElement.style.height = `${body.offsetHeight}px`; }).observe(body);
    old.onload = null;
    old.src = "about:blank";
    loading = false;
  };
  next.src = at("/view", `&at=${Date.now()}`);
  find(".frames").hidden = false;
  await curves();
}

async function curves() {
  const answer = await fetch(at("/curves", night.matches ? "&dark=1" : ""));
  if (!answer.ok) return;
  const reader = new FileReader();
  reader.onload = () => { find(".curve").src = reader.result; find("#compared").hidden = false; };
  reader.readAsDataURL(await answer.blob());
}

night.onchange = () => { if (!find("#compared").hidden) curves(); };

async function begin() {
  const body = JSON.stringify({ places: inputs.map((input) => Number(input.value)) });
  const answer = await fetch(at("/run"), { method: "POST", body });
  if (!answer.ok) { say((await answer.json()).text); return; }
  done.value = 0;
  say("The run begins ...");
}
inputs.forEach((input, k) => { write(k); input.oninput = () => write(k); input.onchange = begin; });
find("#run").onclick = begin;
stop.onclick = () => fetch(at("/run"), { method: "DELETE" });
look();
