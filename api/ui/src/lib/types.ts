/** The shapes of the service's answers, by the names of its OpenAPI document; units stand there. */

import type { components } from '../schema';

export type Schemas = components['schemas'];
