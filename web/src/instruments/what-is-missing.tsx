// The way from errors to the terms that the function may lack.

import { screen } from "../store";

export function WhatIsMissing() {
  return (
    <button
      class="btn small"
      data-ask="missing"
      title="Terms that the function lacks: which channel or lag, and at which node"
      onClick={() => {
        screen.value = "missing";
      }}
    >
      What is missing?
    </button>
  );
}
