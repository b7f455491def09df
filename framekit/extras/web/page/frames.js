// The frames on the lines as they come, with a filter and a pause; a chosen frame shows its bytes under its fields.
import { Grid, changed } from "./parts.js";
import { at } from "./shell.js";
import { count, many } from "./words.js";
import { fieldView } from "./fields.js";

const KEPT = 200, WAIT = 250;

export class Frames {
  constructor(live) {
    this.live = live;
    this.rows = [];
    this.paused = false;
    const columns = [
      { title: "No.", look: "right muted" }, { title: "Time (s)", look: "right" }, { title: "Ch.", look: "right" }, { title: "", look: "way" },
      { title: "Size", look: "right muted" }, { title: "Frame", look: "strong mark", widest: 24 }, { title: "Fields", look: "muted rest" },
    ];
    const picked = key => this.live.say({ frame: Number(key) });
    const empty = () => at("frame-filter").value || at("bad").checked ? "No frame fits the filter" : "No frames yet";
    this.grid = new Grid(at("frames").querySelector(".grid"), columns, { picked, follows: true, empty });
    let waiting = 0;
    at("frame-filter").addEventListener("input", () => { clearTimeout(waiting); waiting = setTimeout(() => this.filter(), WAIT); });
    at("bad").addEventListener("change", () => this.filter());
    at("pause").addEventListener("click", () => this.pause());
  }

  // At every connection: the server has to be told the filter again.
  opened() {
    this.rows.length = 0;
    this.filter();
    this.live.say({ pause: this.paused });
  }

  filter() {
    this.live.say({ filter: at("frame-filter").value, bad: at("bad").checked });
  }

  pause() {
    this.paused = !this.paused;
    at("pause").textContent = this.paused ? "Go on" : "Pause";
    this.live.say({ pause: this.paused });
  }

  take(what) {
    if (what.anew) { this.rows.length = 0; this.grid.follows = true; }
    for (const [no, time, channel, way, size, , name, , fields] of what.frames)
      this.rows.push({ key: no, state: name.startsWith("! ") ? "bad" : "", cells: [no, time, channel, way, size, name, fields] });
    this.rows.splice(0, this.rows.length - KEPT);
    Object.assign(this, { counts: what.counts, missed: what.missed });
    this.head();
    this.grid.rows = this.rows;
    changed(this.grid);
  }

  // The numbers of frames; before a frame is chosen, what a click does.
  head() {
    const [good, bad, noise] = this.counts, more = this.missed ? ` · ${count(this.missed)} more than are shown` : "";
    const hint = at("frame").hidden && this.rows.length ? " · Choose a frame to see its bytes" : "";
    at("frames").querySelector(".count").textContent = `${count(good)} good · ${count(bad)} bad · ${count(noise)} noise${more}${hint}`;
  }

  takeFields(what) {
    at("frame").hidden = false;
    this.head();
    const inside = what.frame && what.frame !== what.what ? ` in ${what.frame}` : "";
    const bytes = what.bytes ?? "", name = `${what.what}${inside} · no. ${what.fields} · ${many(bytes.length / 2, "byte")}`;
    fieldView(at("frame"), what.gone ? `Frame ${what.fields} is no longer kept` : name, bytes, what.rows ?? [], what.fault);
  }
}
