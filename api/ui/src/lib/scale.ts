/** Ticks of axes, and places for the names of marks. */

/** Powers of ten with 2 and 5 between them where there is room; of an axis from `low` to `high`, both above 0. */
export function logTicks(low: number, high: number): { value: number; named: boolean }[] {
  const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
  const wide = Math.log10(high / low) > 2.6;
  const ticks: { value: number; named: boolean }[] = [];
  for (let power = first; power <= last; power += 1) {
    for (let digit = 1; digit < 10; digit += 1) {
      const value = digit * 10 ** power;
      if (value >= low && value <= high) ticks.push({ value, named: digit === 1 || (!wide && (digit === 2 || digit === 5)) });
    }
  }
  return ticks;
}

/** Where an axis begins and ends so that its marks keep off its ends; 0 and what is below it have no place. */
export function logExtent(values: number[], room = 0.09): [number, number] {
  const known = values.filter((v) => v > 0 && Number.isFinite(v));
  if (known.length === 0) return [1, 10];
  const [low, high] = [Math.log10(Math.min(...known)), Math.log10(Math.max(...known))];
  const beyond = Math.max(high - low, 0.5) * room + 0.06;
  return [10 ** (low - beyond), 10 ** (high + beyond)];
}

export interface Box {
  left: number;
  top: number;
  right: number;
  bottom: number;
}
export interface Named {
  x: number;
  y: number;
  text: string;
  /** Names of these find their place first. */
  first?: boolean;
}
export interface Placed {
  x: number;
  y: number;
  anchor: 'start' | 'middle' | 'end';
}

const PLACES: [number, number][] = [
  [10, 0], [-10, 0], [0, -14], [0, 14], [9, -12], [9, 12], [-9, -12], [-9, 12], [14, -24], [14, 24], [-14, -24], [-14, 24],
];

const crosses = (a: Box, b: Box): boolean => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;

/** A place for the name of each mark where it covers no mark, no line and no other name; null where there is none. */
export function placeNames(marks: Named[], lines: Box[], inside: Box, width: (text: string) => number, height = 15): (Placed | null)[] {
  const taken: Box[] = [...marks.map(({ x, y }) => ({ left: x - 7, right: x + 7, top: y - 7, bottom: y + 7 })), ...lines];
  const found: (Placed | null)[] = marks.map(() => null);
  const order = marks.map((_, i) => i).sort((a, b) => Number(marks[b]!.first ?? false) - Number(marks[a]!.first ?? false));
  for (const i of order) {
    const mark = marks[i]!;
    const wide = width(mark.text);
    for (const [dx, dy] of PLACES) {
      const left = dx > 0 ? mark.x + dx : dx < 0 ? mark.x + dx - wide : mark.x - wide / 2;
      const box = { left: left - 2, right: left + wide + 2, top: mark.y + dy - height / 2, bottom: mark.y + dy + height / 2 };
      const whole = box.left >= inside.left && box.right <= inside.right && box.top >= inside.top && box.bottom <= inside.bottom;
      if (!whole || taken.some((other, j) => j !== i && crosses(box, other))) continue;
      taken.push(box);
      found[i] = { x: mark.x + dx, y: mark.y + dy, anchor: dx > 0 ? 'start' : dx < 0 ? 'end' : 'middle' };
      break;
    }
  }
  return found;
}

let pen: CanvasRenderingContext2D | null = null;

/** How wide a text is in the font of the page, pixels. */
export function textWidth(text: string, size = 13): number {
  pen ??= document.createElement('canvas').getContext('2d');
  if (!pen) return 0.6 * size * text.length;
  pen.font = `${size}px ${getComputedStyle(document.documentElement).fontFamily}`;
  return pen.measureText(text).width;
}
