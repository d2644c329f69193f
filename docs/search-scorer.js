/* Order of search results: those whose title has all words come first, the changelog last. */
var Scorer = {
  score: ([page, title, , , score]) => {
    const words = (new URLSearchParams(location.search).get("q") || "").toLowerCase().split(/\s+/);
    const isAbout = words.every((word) => title.toLowerCase().includes(word));
    return score + (isAbout ? 20 : 0) - (page === "changelog" ? 20 : 0);
  },
  // Sphinx's own values.
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
