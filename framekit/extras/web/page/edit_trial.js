// A trial: one request to the simulated device of the protocol, or some seconds of a run, and the frames of both sides.
import { fieldView } from "./fields.js";
import { element } from "./parts.js";

export class Trial {
  // `tries({service, address, values, station})`: asks for the exchange.
  constructor(place, tries) {
    Object.assign(this, { tries, fields: {} });
    this.form = element("form", place);
    this.result = element("p", place);
    this.result.setAttribute("role", "status");
    this.frames = element("div", place);
    this.form.addEventListener("submit", event => { event.preventDefault(); this.send(); });
  }

  // The form stays as it is when the same is offered again: someone may be typing into it.
  offer(offered) {
    const known = JSON.stringify(offered);
    if (known === this.known) return;
    this.known = known;
    const { services = [], run = "", address = "", station = "", why = "" } = offered;
    const before = Object.fromEntries(Object.entries(this.fields).map(([name, field]) => [name, field.value]));
    this.form.replaceChildren();
    this.fields = {};
    if (why) Object.assign(element("p", this.form), { className: "why", textContent: why });
    if (!services.length && !run) return;
    if (run) element("p", this.form).textContent = `The run is carried out for ${run} on simulated lines, without its sinks.`;
    else this.request(services, { address, station, ...before });
    Object.assign(element("button", this.form), { textContent: "Try it", className: "main" });
  }

  request(services, values) {
    const line = element("div", this.form);
    line.className = "values";
    const list = this.fields.service = this.field(line, "select", "service");
    for (const [name] of services) Object.assign(element("option", list), { textContent: name, value: name });
    if (services.some(([name]) => name === values.service)) list.value = values.service;
    for (const name of ["address", "values", "station"])
      this.fields[name] = Object.assign(this.field(line, "input", name), { value: values[name] ?? "", spellcheck: false, autocomplete: "off" });
    const hint = () => {
      const [service, takes] = services.find(([name]) => name === list.value);
      this.fields.values.placeholder = service === "write" ? "1 2 3" : takes.map(name => `${name}=…`).join(" ");
      this.fields.values.disabled = service === "read";
    };
    list.addEventListener("change", hint);
    hint();
  }

  field(line, kind, name) {
    const label = element("label", line);
    element("span", label).textContent = name[0].toUpperCase() + name.slice(1);
    const field = element(kind, label);
    field.dataset.trial = name;
    return field;
  }

  send() {
    this.result.textContent = "…";
    this.frames.replaceChildren();
    this.tries(Object.fromEntries(["service", "address", "values", "station"].map(name => [name, this.fields[name]?.value ?? ""])));
  }

  show({ why = "", result = "", frames = [] }) {
    Object.assign(this.result, { textContent: why || result, className: why ? "why" : "result" });
    this.frames.replaceChildren();
    for (const [time, direction, name, bytes, rows, fault] of frames) {
      const one = element("details", this.frames), head = element("summary", one);
      one.className = "exchange";
      element("span", head).textContent = `${time} ms`;
      Object.assign(element("b", head), { textContent: `${direction === "out" ? "→" : "←"} ${name}`, className: fault ? "wrong" : "" });
      element("code", head).textContent = bytes.match(/../g)?.join(" ").toUpperCase() ?? "";
      const inside = element("div", one);
      one.addEventListener("toggle", () => { if (one.open && !inside.children.length) fieldView(inside, `${name} · ${bytes.length / 2} bytes`, bytes, rows, fault); });
    }
  }
}
