"""Components of ASCET 5 and 6: `.amd` files in XML, and `.axl` archives of them."""
