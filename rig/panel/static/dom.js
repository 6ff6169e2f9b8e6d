// Small helpers for the page's elements. Text from elsewhere becomes text, never markup.

/** What a box to tick says of its key. */
export const ENTER_TICKS = "Enter ticks this box; space is Stop";

/** The element with this id. */
export const byId = (id) => document.getElementById(id);

/** A new element: its properties, then its children (nodes or text). */
export function element(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** A text with what stands between `backticks` as code: nodes for an element. */
export const withCode = (text) => text.split(/`([^`\n]+)`/).map((part, place) => (place % 2 === 1 ? element("code", { textContent: part }) : part));

/** Set an element's text. Nothing happens if it is there already, so that a live number costs no layout. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Show or hide an element. */
export function show(node, visible) {
  if (node.hidden === visible) node.hidden = !visible;
}

/** For what the server does aside: longer than it waits for that, `_PATIENCE_S` in aside.py, and for what is before it. */
export const ASIDE = { timeout_ms: 6_000_000 };

/** Ask the server. Raises an Error whose message is for the reader. */
export async function ask(path, body, { timeout_ms = 20000 } = {}) {
  const options = { signal: AbortSignal.timeout(timeout_ms), headers: { accept: "application/json" } };
  if (body !== undefined) {
    options.method = "POST";
    options.headers["content-type"] = "application/json";
    options.body = JSON.stringify(body);
    options.keepalive = true; // also from a tab that is being closed
  }
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    throw new Error(error.name === "TimeoutError" ? "The panel's server did not answer." : "The panel's server cannot be reached.");
  }
  const answer = await response.json().catch(() => null);
  if (!response.ok) {
    const said = answer?.error;
    throw new Error(said?.what ? `${said.what} ${said.cure ?? ""}`.trim() : (said ?? `The server answered ${response.status}.`));
  }
  return answer;
}
