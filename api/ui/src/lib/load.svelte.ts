/** What a view shows: loading, there, or refused. */

import { get, Problem } from './session.svelte';

export class Loaded<T> {
  value = $state<T | null>(null);
  problem = $state<Problem | null>(null);
  loading = $state(true);
  #asked = 0;

  /** Ask for `path`; a later question makes an earlier answer void. */
  async ask(path: string): Promise<void> {
    const mine = ++this.#asked;
    this.loading = true;
    try {
      const value = await get<T>(path);
      if (mine === this.#asked) {
        this.value = value;
        this.problem = null;
      }
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      if (mine === this.#asked) this.problem = error;
    }
    if (mine === this.#asked) this.loading = false;
  }
}
