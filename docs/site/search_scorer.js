// The search finds what the machine is and does before the Python that does it.
const WEIGHT = [[/^docs\/reference\/api\//, 0.2], [/^CHANGELOG|^CONTRIBUTING|^docs\/design/, 0.4], [/^docs\/reference\//, 0.7],
  [/^docs\/(equations|machine|fidelity|identification|coupling)/, 2], [/^docs\/tutorials\//, 1.5]];

var Scorer = {
  score: ([page, , , , score]) => score * (WEIGHT.find(([pattern]) => pattern.test(page)) ?? [null, 1])[1],
  objNameMatch: 4, objPartialMatch: 2, objPrio: { 0: 2, 1: 1, 2: 0 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
