import { expect, test } from "vitest";
import { formatRoute, isSamePlace, parseRoute, type Route } from "../src/route";

const ROUTES: [string, Route][] = [
  ["#/", { project: "", screen: null, name: "" }],
  ["#/torque-1a2b", { project: "torque-1a2b", screen: null, name: "" }],
  ["#/torque-1a2b/results", { project: "torque-1a2b", screen: "results", name: "" }],
  ["#/torque-1a2b/parameters/Map%2FA%20%25", { project: "torque-1a2b", screen: "parameters", name: "Map/A %" }],
];

test.each(ROUTES)("the address %s is read as it is written", (hash, route) => {
  expect(parseRoute(hash)).toEqual(route);
  expect(formatRoute(route)).toBe(hash);
});

test.each([
  ["", ""],
  ["#", ""],
  ["#top", "top"],
  ["#/p/nowhere/%", "p"],
])("an address that nobody wrote, %s, names no screen", (hash, project) => {
  expect(parseRoute(hash)).toMatchObject({ project, screen: null });
});

test("another parameter is the same place, another screen or project is not", () => {
  const own: Route = { project: "p", screen: "parameters", name: "MapA" };
  expect(isSamePlace(own, { ...own, name: "MapB" })).toBe(true);
  expect(isSamePlace(own, { ...own, screen: "data", name: "" })).toBe(false);
  expect(isSamePlace(own, { ...own, project: "q" })).toBe(false);
});
