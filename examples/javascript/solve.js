// SPDX-License-Identifier: Apache-2.0
// Solves a BAL file in two goes: a callback stops the first, the second runs to the end.
//
//     npm ci && node solve.js FILE
import { Context, Problem, USER_STOP, checkVersion } from './clba.js';

const print = (row) =>
  console.log(`${String(row.iteration).padStart(3)}  cost ${row.cost.toExponential(6)}`);

if (process.argv.length !== 3) {
  console.error('usage: node solve.js FILE');
  process.exit(1);
}
checkVersion();
const problem = Problem.readBal(process.argv[2]);
const context = new Context();

const stopped = problem.solve(context, (row) => {
  print(row);
  return row.iteration < 3;
});
const halfWay = stopped.summary();
if (halfWay.termination !== USER_STOP) {
  throw new Error(`not stopped by the callback: ${halfWay.message}`);
}
console.log(`stopped at ${halfWay.final_cost.toExponential(16)}`);

// It goes on from the state that the first solve left.
const result = problem.solve(context, (row) => {
  print(row);
  return true;
});
process.stdout.write(result.report());
console.log(`final cost ${result.summary().final_cost.toExponential(16)}`);

result.close();
stopped.close();
context.close();
problem.close();
