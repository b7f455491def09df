// The faults of the devices, each with a switch and the number of its occurrences.
import { element } from "./parts.js";
import { at } from "./shell.js";
import { many } from "./words.js";

export class Faults {
  constructor(live) {
    this.live = live;
    this.lines = [];
  }

  begin(devices) {
    at("fault-list").replaceChildren();
    this.lines = devices.map(({ name, faults }, device) => {
      if (devices.length > 1) element("h3", at("fault-list")).textContent = name;
      return faults.map((text, number) => this.line(text, device, number));
    });
    at("faults").hidden = !devices.some(one => one.faults.length);
  }

  line(text, device, number) {
    const label = element("label", at("fault-list")), box = element("input", label);
    label.className = "switch";
    box.type = "checkbox";
    box.setAttribute("role", "switch");
    element("span", label).textContent = text;
    const count = element("span", label);
    count.className = "count";
    box.addEventListener("change", () => {
      const on = box.checked;
      if (!this.live.may) { box.checked = !on; at("lock").open = true; at("token").focus(); return; }
      this.live.act({ fault: device, number, on }, why => this.live.tell(why ? `Refused: ${why}` : `${text} is switched ${on ? "on" : "off"}`));
    });
    return { box, count, label };
  }

  ask() {
    this.live.say({ faults: true });
  }

  take({ faults }) {
    faults.forEach((list, device) => list.forEach(([on, done], number) => {
      const line = this.lines[device]?.[number];
      if (!line) return;
      line.box.checked = on;
      line.label.classList.toggle("on", on);
      line.count.textContent = done ? many(done, "time") : "";
    }));
  }
}
