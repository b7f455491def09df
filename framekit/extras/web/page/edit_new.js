// The dialog for a new file: its kind, its name, and the protocol or the device file that it is for.
import { element } from "./parts.js";

const KINDS = [["protocol", "Protocol"], ["device", "Simulated device"], ["run", "Run"], ["points", "Points"]];
const ENDS = { protocol: ".yaml", device: ".device.yaml", run: ".run.yaml", points: ".points.yaml" };
const OTHERS = /\.(device|run|points|vectors|faults|jobs|memory)\.ya?ml$/;

export class NewFile {
  // `create(what, ended)`: makes a file; `ended(why)`: '' when it is made.
  constructor(create) {
    this.create = create;
    this.known = [];
  }

  // `files`: those of the folder.
  ask(files) {
    this.dialog?.remove();
    this.files = files;
    const dialog = this.dialog = element("dialog", document.body), form = element("form", dialog);
    dialog.id = "ask";
    form.autocomplete = "off";
    element("h2", form).textContent = "New file";
    this.kind = this.field(form, "Kind", "select", "new-kind");
    for (const [value, textContent] of KINDS) Object.assign(element("option", this.kind), { value, textContent });
    this.name = this.field(form, "Name", "input", "new-name");
    Object.assign(this.name, { placeholder: "small letters and digits, such as lamp", spellcheck: false, required: true, maxLength: 40 });
    this.of = this.field(form, "Protocol", "input", "new-of");
    Object.assign(this.of, { spellcheck: false, placeholder: "such as modbus-tcp" });
    this.of.setAttribute("list", "new-known");
    this.list = element("datalist", form);
    this.list.id = "new-known";
    this.becomes = element("p", form);
    this.why = element("p", form);
    this.why.className = "why";
    this.why.setAttribute("role", "alert");
    const foot = element("footer", form), cancel = element("button", foot), go = element("button", foot);
    Object.assign(cancel, { type: "button", textContent: "Cancel" });
    Object.assign(go, { className: "main", textContent: "Create" });
    cancel.addEventListener("click", () => dialog.close());
    for (const field of [this.kind, this.name]) field.addEventListener("input", () => this.show());
    form.addEventListener("submit", event => {
      event.preventDefault();
      go.disabled = true;
      this.why.textContent = "";
      this.create({ new: this.kind.value, name: this.name.value, of: this.kind.value === "protocol" ? "" : this.of.value }, why => {
        go.disabled = false;
        this.why.textContent = why;
        if (!why) dialog.close();
      });
    });
    this.show();
    dialog.showModal();
    this.name.focus();
  }

  field(form, text, kind, id) {
    const label = element("label", form);
    label.textContent = text;
    return Object.assign(element(kind, label), { id });
  }

  // Protocols that can be named.
  take(known) {
    this.known = known;
    if (this.dialog?.open) this.show();
  }

  show() {
    const kind = this.kind.value, label = this.of.parentElement;
    label.hidden = kind === "protocol";
    label.firstChild.textContent = kind === "device" ? "Protocol" : "Device file or protocol";
    const own = this.files.filter(name => !name.includes("/") && (OTHERS.test(name) ? kind !== "device" && name.endsWith(ENDS.device) : name.endsWith(".yaml")));
    this.list.replaceChildren();
    for (const value of [...own.map(name => OTHERS.test(name) ? name : name.replace(/\.yaml$/, "")), ...this.known])
      element("option", this.list).value = value;
    this.becomes.textContent = this.name.value ? `Makes the file ${this.name.value}${ENDS[kind]}` : "";
  }
}
