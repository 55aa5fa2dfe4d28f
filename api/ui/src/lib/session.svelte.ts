/** Who sits at this browser, and how requests carry that. */

import type { Schemas } from './types';

export type Me = Schemas['Me'];
export type Role = Me['role'];

const RANK: Record<Role, number> = { viewer: 0, operator: 1, metrologist: 2, admin: 3 };

class Session {
  me = $state<Me | null>(null);
  /** Before the server has said who this is. */
  asking = $state(true);
  /** Why the token of the address did not do; empty where there was none. */
  refused = $state('');
}

export const session = new Session();

/** Whether the person may do what needs `role`. */
export function may(role: Role): boolean {
  return session.me !== null && RANK[session.me.role] >= RANK[role];
}

/** A refusal of the server, RFC 9457. */
export class Problem extends Error {
  constructor(
    readonly status: number,
    readonly title: string,
    detail: string,
    readonly errors: Schemas['Fault'][] = [],
  ) {
    super(detail);
  }
}

async function problem(response: Response): Promise<Problem> {
  try {
    const body = await response.json();
    return new Problem(response.status, body.title ?? response.statusText, body.detail ?? body.title ?? '', body.errors ?? []);
  } catch {
    return new Problem(response.status, response.statusText, `The service answered ${response.status}.`);
  }
}

/** One request of the public API; raises `Problem`. A `body` that is no string is sent as JSON. */
export async function call<T>(method: string, path: string, body?: unknown, headers: Record<string, string> = {}): Promise<T> {
  const sent: RequestInit = { method, headers: { Accept: 'application/json', ...headers }, credentials: 'same-origin' };
  const fields = sent.headers as Record<string, string>;
  if (session.me?.csrf && method !== 'GET') fields['X-CSRF-Token'] = session.me.csrf;
  if (body !== undefined) {
    const raw = typeof body === 'string' || body instanceof Blob;
    sent.body = raw ? body : JSON.stringify(body);
    if (!fields['Content-Type']) fields['Content-Type'] = 'application/json';
  }
  let response: Response;
  try {
    response = await fetch(path, sent);
  } catch {
    throw new Problem(0, 'No connection', 'The service does not answer; it may be restarting.');
  }
  if (response.status === 401 && path !== '/api/login') session.me = null;
  if (!response.ok) throw await problem(response);
  return (response.status === 204 ? undefined : await response.json()) as T;
}

export const get = <T>(path: string): Promise<T> => call<T>('GET', path);
export const post = <T>(path: string, body?: unknown, headers?: Record<string, string>): Promise<T> => call<T>('POST', path, body, headers);

/** Do something that the service may refuse: the refusal, or null where it did not. */
export async function refusal(act: () => Promise<unknown>): Promise<Problem | null> {
  try {
    await act();
    return null;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    return error;
  }
}

/** A token in the fragment, which no server and no log sees, becomes a session and leaves the address. */
export async function begin(): Promise<void> {
  const token = new URLSearchParams(location.hash.slice(1)).get('token');
  if (token) history.replaceState(null, '', location.pathname + location.search);
  try {
    session.me = token ? await post<Me>('/api/login', { token }) : await get<Me>('/api/me');
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    session.me = null;
    session.refused = token ? error.message : '';
  }
  session.asking = false;
}

export async function login(credentials: { name: string; password: string } | { token: string }): Promise<void> {
  session.me = await post<Me>('/api/login', credentials);
}

export async function logout(): Promise<void> {
  await post('/api/logout');
  session.me = null;
}
