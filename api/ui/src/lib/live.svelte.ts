/** What the bench and the queue are at now: asked once, then followed by server-sent events. */

import { get, Problem } from './session.svelte';

export interface Span {
  seconds: number;
  low: number;
  high: number;
}

export interface Prompt {
  entry: number;
  scan: number;
  sample: string;
  kind: 'reference' | 'sample' | 'spot';
  request: string;
  check: string;
  since: string;
}

export interface Running {
  entry: number;
  campaign: string;
  scan: number;
  sample: string;
  kind: 'reference' | 'sample' | 'spot';
  phase: 'idle' | 'running' | 'pausing' | 'paused' | 'aborting' | 'finished';
  done: number;
  failed: number;
  expected: number;
  theta_in: number | null;
  theta_out: number | null;
  bench_elapsed: number;
  bench_remaining: Span;
  remaining: number | null;
  waiting: string | null;
}

export interface Bench {
  phase: 'disconnected' | 'connecting' | 'ready' | 'busy' | 'running' | 'stopping';
  doing: string;
  possible: string[];
  driver: { url: string; host: string; process: number; since: string; here: boolean } | null;
  simulated: boolean;
  stages: { name: 'sample' | 'detector'; angle: number | null; phase: string; moving: boolean; limits: [number, number] }[];
  theta_in: number | null;
  theta_out: number | null;
  blocked_half_width: number;
  detector_temperature: number | null;
  cooler_set_point: number;
  lamp_on_for: number | null;
  shutter: 'open' | 'closed' | 'unknown';
  integration_time: number | null;
  integration_limits: [number, number] | null;
  spectrum: number | null;
  running: Running | null;
  prompt: Prompt | null;
  alarms: { text: string; since: string }[];
}

export interface Entry {
  id: number;
  position: number;
  campaign: string;
  campaign_id: number | null;
  phase: 'idle' | 'queued' | 'running' | 'pausing' | 'paused' | 'aborting' | 'finished';
  outcome: 'completed' | 'aborted' | 'failed' | null;
  reason: string;
  who: string;
  start_after: string | null;
  created: string;
  started: string | null;
  finished: string | null;
  scans: { id: number; name: string; kind: 'reference' | 'sample' | 'spot'; phase: string; outcome: string | null; points_done: number }[];
  scan: number | null;
  points_done: number;
  points_expected: number | null;
  remaining: Span | null;
  pause_takes_effect: string | null;
  prompt: Prompt | null;
}

export interface Page<T> {
  items: T[];
  next: string | null;
}

class Live {
  bench = $state<Bench | null>(null);
  queue = $state<Entry[]>([]);
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

async function readBench(): Promise<void> {
  try {
    live.bench = await get<Bench>('/api/instrument');
    live.problem = null;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    live.problem = error;
    // the process that drives the bench may still be starting
    if (live.connected) setTimeout(() => void readBench(), 1500);
  }
}

export async function readQueue(): Promise<void> {
  try {
    live.queue = (await get<Page<Entry>>('/api/queue?limit=200')).items;
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
  const on = (kind: string, act: (data: unknown) => void): void => {
    stream?.addEventListener(kind, (event) => act(JSON.parse((event as MessageEvent<string>).data)));
  };
  on('state', (data) => (live.bench = data as Bench));
  on('spectrum', () => (live.spectra += 1));
  on('point', () => {
    live.points += 1;
    queueChanged();
  });
  for (const kind of ['progress', 'queue', 'mount']) on(kind, queueChanged);
  on('job', () => (live.jobs += 1));
  on('alarm', () => void readBench());
  on('reset', everything);
}

export function leave(): void {
  stream?.close();
  stream = null;
  live.connected = false;
}
