/** What the bench and the queue are at now: asked once, then followed by server-sent events. */

import { get, Problem } from './session.svelte';
import type { Schemas } from './types';

export type Bench = Schemas['BenchState'];
export type Entry = Schemas['EntryView'];
type EventData = Schemas['EventData'];

export interface Page<T> {
  items: T[];
  next: string | null;
}

class Live {
  bench = $state<Bench | null>(null);
  queue = $state<Entry[]>([]);
  /** Whether the queue was ever read; before, nobody knows that it is empty. */
  queueRead = $state(false);
  connected = $state(false);
  problem = $state<Problem | null>(null);
  /** Grows with every spectrum that was read; a view that shows it asks anew. */
  spectra = $state(0);
  /** Grows with every finished point. */
  points = $state(0);
  /** Grows with everything that happens to a job. */
  jobs = $state(0);
}

export const live = new Live();

let stream: EventSource | null = null;
let queueSoon: ReturnType<typeof setTimeout> | null = null;
/** Numbers of questions, so that an answer that comes late replaces nothing newer. */
let benchAsked = 0;
let queueAsked = 0;
let queueShown = 0;

async function readBench(): Promise<void> {
  const asked = ++benchAsked;
  try {
    const found = await get<Bench>('/api/instrument');
    if (asked === benchAsked) live.bench = found;
    live.problem = null;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    live.problem = error;
    // the process that drives the bench may still be starting
    if (live.connected) setTimeout(() => void readBench(), 1500);
  }
}

export async function readQueue(): Promise<void> {
  const asked = ++queueAsked;
  try {
    const found = await get<Page<Entry>>('/api/queue?limit=200');
    if (asked < queueShown) return;
    queueShown = asked;
    live.queue = found.items;
    live.queueRead = true;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    live.problem = error;
  }
}

/** Points come many a second; the queue is asked for at most twice a second. */
function queueChanged(): void {
  queueSoon ??= setTimeout(() => {
    queueSoon = null;
    void readQueue();
  }, 500);
}

function everything(): void {
  void readBench();
  void readQueue();
  live.spectra += 1;
  live.points += 1;
  live.jobs += 1;
}

/** Begin to follow what happens. The browser comes back by itself after a break and says what it saw last. */
export function follow(): void {
  stream?.close();
  stream = new EventSource('/api/events');
  stream.onopen = () => {
    live.connected = true;
    everything();
  };
  stream.onerror = () => {
    live.connected = false;
    // a refusal ends the stream for good; a break does not
    if (stream?.readyState === EventSource.CLOSED) setTimeout(follow, 2000);
  };
  const on = <K extends keyof EventData>(kind: K, act: (data: EventData[K]) => void): void => {
    stream?.addEventListener(kind, (event) => act(JSON.parse((event as MessageEvent<string>).data)));
  };
  on('state', (data) => {
    benchAsked += 1; // whatever was asked before is older than this
    live.bench = data;
  });
  on('spectrum', () => (live.spectra += 1));
  on('point', () => {
    live.points += 1;
    queueChanged();
  });
  for (const kind of ['progress', 'queue', 'mount'] as const) on(kind, queueChanged);
  on('job', () => (live.jobs += 1));
  on('alarm', () => void readBench());
  on('reset', everything);
}

export function leave(): void {
  stream?.close();
  stream = null;
  live.connected = false;
}
