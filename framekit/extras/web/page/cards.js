// The cards at the head of a page: value, sentence, and a colour for what is not as it should be.
import { FEWEST, MINUTE, sparkline } from "./draw.js";
import { element } from "./parts.js";
import { onTheme } from "./shell.js";

export class Cards {
  constructor(place) {
    this.place = place;
    this.cards = [];
    onTheme(() => this.paint());
  }

  // `cards`: title, value, sentence, state, and a number to draw or null.
  take(cards) {
    while (this.cards.length < cards.length) this.cards.push(this.made());
    cards.forEach(([title, value, text, state, number], at) => {
      const { box, head, big, small } = this.cards[at];
      box.className = `card ${state}`;
      head.textContent = title;
      big.textContent = big.title = value;
      small.textContent = small.title = text;
      this.cards[at].number = number;
    });
  }

  made() {
    const box = element("section", this.place), head = element("h2", box), canvas = element("canvas", box);
    Object.assign(canvas, { width: 160, height: 60, hidden: true });
    return { box, head, canvas, big: element("b", box), small: element("p", box), numbers: [], number: null };
  }

  // Called once a second: the numbers move on.
  second() {
    for (const card of this.cards) {
      if (card.number === null && !card.numbers.length) continue;
      card.numbers.push(card.number);
      if (card.numbers.length > MINUTE) card.numbers.shift();
    }
    this.paint();
  }

  paint() {
    for (const { canvas, numbers } of this.cards) {
      canvas.hidden = numbers.length < FEWEST;
      if (!canvas.hidden) sparkline(canvas, numbers, [0, Math.max(1e-3, ...numbers) * 1.1], numbers.length);
    }
  }
}
