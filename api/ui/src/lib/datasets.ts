/** What the service tells of datasets. */

import type { Schemas } from './types';

export type DatasetRow = Schemas['DatasetRow'];
export type Dataset = Schemas['DatasetDetail'];
export type MapCell = Schemas['MapCell'];
export type InPlane = Schemas['InPlaneMap'];
export type PointSpectrum = Schemas['PointSpectrum'];
export type Job = Schemas['JobView'];
