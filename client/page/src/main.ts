/** Choose a set-up or session, move its variables, see the mesh. */
import "./page.css";
import * as api from "./api";
import { View } from "./view";

const element = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;
const choice = element<HTMLSelectElement>("choice"), message = element("message");
const view = new View(element<HTMLCanvasElement>("view"));
let session = "", setup: api.Setup, design = new Float64Array(0), good = design, history: Float64Array<ArrayBuffer>[] = [];
let running = false, wanted = false;

function say(text: string, refused = false): void { message.textContent = text; message.classList.toggle("refused", refused); }

async function attempt(work: () => Promise<void>): Promise<void> {
  try { await work(); } catch (error) {
    if (error instanceof api.Refused && error.status === 401) element("access").hidden = false;
    say(error instanceof api.Refused ? error.message : "The server cannot be reached.", true);
  }
}

async function lists(): Promise<void> {
  const setups = await api.list<{ setup_id: string; name: string }>("/v1/setups", "setups");
  const sessions = await api.list<{ session_id: string; label: string }>("/v1/sessions", "sessions");
  choice.replaceChildren(new Option("choose", ""),
    ...setups.map((entry) => new Option(`new session: ${entry.name}`, `setup ${entry.setup_id}`)),
    ...sessions.map((entry) => new Option(`session ${entry.label || entry.session_id.slice(0, 8)}`, `session ${entry.session_id}`)));
  say(setups.length ? "" : "There are no set-ups yet.");
}

type Session = { session_id: string; setup_id: string; design: { design: number[] } };
async function open(): Promise<void> {
  const [kind, id] = choice.value.split(" ");
  if (!id) return;
  const path = kind === "setup" ? `/v1/setups/${id}/sessions` : `/v1/sessions/${id}`;
  const opened = (await api.json<{ session: Session }>(path, { method: kind === "setup" ? "POST" : "GET" })).session;
  const described = await api.json<{ setup: api.Setup; mesh: api.Mesh }>(`/v1/setups/${opened.setup_id}?include_mesh=true`);
  session = opened.session_id; setup = described.setup; history = [];
  design = good = Float64Array.from(opened.design.design);
  view.show(described.mesh, setup.components.length);
  element("components").replaceChildren(...setup.components.map((name, index) => {
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: true });
    box.onchange = () => view.setVisible(index, box.checked);
    const label = document.createElement("label");
    label.append(box, ` ${name}`);
    return label;
  }));
  sliders();
  move();
}

function sliders(): void {
  element("sliders").replaceChildren(...setup.variables.map(({ name, unit, lower, upper }, index) => {
    const value = document.createElement("output"), label = document.createElement("label");
    const range = Object.assign(document.createElement("input"), { type: "range", min: `${lower}`, max: `${upper}`, step: "any" });
    const write = () => { value.textContent = ` ${design[index].toPrecision(4)} ${unit} (${lower} to ${upper})`; };
    range.value = `${design[index]}`;
    range.oninput = () => { design = design.slice(); design[index] = range.valueAsNumber; write(); move(); };
    write();
    label.append(name, value, range);
    return label;
  }));
}

/** One request at a time; of the designs that come meanwhile the latest counts. */
async function move(): Promise<void> {
  wanted = true;
  if (running) return;
  running = true;
  while (wanted) {
    wanted = false;
    const asked = design, from = session, start = performance.now();
    await attempt(async () => {
      const vertices = await api.deform(from, asked);
      if (from !== session) return;
      view.move(vertices);
      if (asked !== good) history.push(good);
      if (history.length > 1000) history.shift();
      good = asked;
      say(`${(performance.now() - start).toFixed(0)} ms`);
    });
  }
  running = false;
}

function go(to: Float64Array<ArrayBuffer>): void { design = to; sliders(); void move(); }
const named = () => Object.fromEntries(setup.variables.map(({ name }, index) => [name, good[index]]));
element("undo").onclick = () => { const last = history.pop(); if (last) { good = last; go(last); } };
element("reset").onclick = () => { if (session) go(Float64Array.from(setup.variables.map(({ baseline }) => baseline))); };
element("json").onclick = () => { if (session) void navigator.clipboard.writeText(JSON.stringify(named())); };
element("python").onclick = () => { if (session) void navigator.clipboard.writeText(`session.deform(${JSON.stringify(named())})`); };
element("access").onsubmit = (event) => { event.preventDefault(); api.keepToken(element<HTMLInputElement>("token").value); element("access").hidden = true; void attempt(lists); };
choice.onchange = () => void attempt(open);
void attempt(lists);
