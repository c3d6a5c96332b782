/** The server's HTTP interface. The token is kept for this tab only, and never put into an address. */
export interface Variable { name: string; unit: string; baseline: number; lower: number; upper: number }
export interface Group { name: string; first: number; shape: number[] }
export interface Setup { name: string; variables: Variable[]; groups: Group[]; components: string[] }
export interface Mesh { vertices: number[][]; cells: number[][]; cell_owner: number[] }

/** What the server refused, in its words. */
export class Refused extends Error {
  constructor(readonly status: number, message: string) { super(message); }
}

export function keepToken(token: string): void { sessionStorage.setItem("token", token); }

async function call(path: string, init: RequestInit = {}): Promise<Response> {
  const headers = new Headers(init.headers);
  const token = sessionStorage.getItem("token");
  if (token) headers.set("Authorization", `Bearer ${token}`);
  const answer = await fetch(path, { ...init, headers });
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  throw new Refused(answer.status, problem.detail ?? problem.title ?? `the server answered ${answer.status}`);
}

export async function json<T>(path: string, init?: RequestInit): Promise<T> { return (await call(path, init)).json(); }

/** All entries of a list, page by page. */
export async function list<T>(path: string, field: string): Promise<T[]> {
  const entries: T[] = [];
  for (let token = ""; ;) {
    const page = await json<Record<string, unknown>>(`${path}?page_token=${encodeURIComponent(token)}`);
    entries.push(...(page[field] as T[]));
    token = page.next_page_token as string;
    if (!token) return entries;
  }
}

/** Vertices at a design, (n, 3) one after the other, m. */
export async function deform(session: string, design: Float64Array<ArrayBuffer>): Promise<Float64Array> {
  const headers = { "Content-Type": "application/octet-stream", Accept: "application/octet-stream" };
  const answer = await call(`/v1/sessions/${session}/deform`, { method: "POST", headers, body: design });
  return new Float64Array(await answer.arrayBuffer());
}
