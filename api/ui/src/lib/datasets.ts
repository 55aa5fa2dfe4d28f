/** What the service tells of datasets; see /api/openapi.json for units. */

export interface DatasetRow {
  id: number;
  sample: string;
  kind: 'measured' | 'simulated' | 'imported';
  campaign_id: number | null;
  campaign: string | null;
  scan_id: number | null;
  created: string;
  points: number;
  incident_angles: number;
  wavelengths_nm: [number, number];
  flags: string[];
  flagged: number;
  checks_failed: number;
  recalibrated_from: number | null;
  content_hash: string;
  software_version: string;
}

export interface Dataset extends DatasetRow {
  theta_in_deg: number[];
  theta_out_deg: [number, number];
  wavelength_count: number;
  aperture_deg: number;
  median_relative_u: number | null;
  flag_uses: { flag: string; meaning: string; points: number }[];
  fitted: string[];
  certificate_override: string | null;
}

interface Edges {
  left: number;
  right: number;
  bottom: number;
  top: number;
}

export interface MapCell {
  point: number;
  theta_in_deg: number;
  theta_out_deg: number;
  edges: Edges;
  colour: string | null;
  hue: string | null;
  luminance: number | null;
  flags: string[];
  flag_words: string;
  dE00: number | null;
}

export interface FilledCell {
  theta_in_deg: number;
  theta_out_deg: number;
  edges: Edges;
  by: 'reciprocity' | 'interpolation';
  colour: string | null;
  hue: string | null;
}

export interface InPlane {
  dataset: number;
  sample: string;
  exposure: number | null;
  clipped: number;
  difference_model: string | null;
  cells: MapCell[];
  filled: FilledCell[];
  not_filled: number;
  blocked: Edges[];
  blocked_half_width_deg: number;
}

export interface PointSpectrum {
  dataset: number;
  point: number;
  theta_in_deg: number;
  theta_out_deg: number;
  wavelengths_nm: number[];
  brdf: (number | null)[];
  u: (number | null)[];
  local: {
    parameters: { slope_per_um: number | null; u_slope_per_um: number | null; exponent: number | null; u_exponent: number | null; r2: number | null; reliable: boolean };
    fitted: (number | null)[];
  } | null;
  model: string | null;
  modelled: (number | null)[] | null;
  dE00: number | null;
  dE00_chromatic: number | null;
  flags: string[];
  flag_words: string;
  exposures: number[];
}

export interface Job {
  id: number;
  kind: string;
  title: string;
  who: string;
  state: 'waiting' | 'running' | 'done' | 'failed' | 'cancelled' | 'interrupted';
  share: number | null;
  words: string;
  reason: string;
  arguments: Record<string, unknown>;
  created: string;
  started: string | null;
  finished: string | null;
  has_result: boolean;
  has_page: boolean;
}
