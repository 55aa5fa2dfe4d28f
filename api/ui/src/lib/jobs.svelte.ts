/** Work that takes longer than an answer: asked for here, followed by events. */

import type { Job } from './datasets';
import { live, type Page } from './live.svelte';
import { get } from './session.svelte';

/** The newest jobs of some kinds; asks anew when something happens to a job. */
export class Jobs {
  items = $state<Job[]>([]);

  /** Call inside an effect. */
  follow(kind: string | null = null): void {
    void live.jobs;
    get<Page<Job>>(`/api/jobs?limit=30${kind ? `&kind=${kind}` : ''}`).then(
      (found) => (this.items = found.items),
      () => undefined,
    );
  }
}
