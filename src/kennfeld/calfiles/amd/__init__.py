"""Parameters of ASCET 5 and 6 components: `.axl` archives and `.data.amd` files."""
