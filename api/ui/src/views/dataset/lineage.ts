export interface LineageNode {
  kind: string;
  title: string;
  href: string | null;
  ids: number[];
  about: Record<string, string>;
  sources: LineageNode[];
}
