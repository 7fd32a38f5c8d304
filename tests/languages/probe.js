// SPDX-License-Identifier: Apache-2.0
// node probe.js FILE ABSENT: struct layouts, a callback that throws, and an error.
import koffi from 'koffi';
import { ClbaError, Context, Problem, structs } from './clba.js';

for (const [name, struct] of Object.entries(structs)) {
  console.log(`size ${name} ${koffi.sizeof(struct)}`);
  for (const [field, { offset, type }] of Object.entries(struct.members)) {
    console.log(`layout ${name}.${field} ${offset} ${koffi.sizeof(type)}`);
  }
}

const problem = Problem.readBal(process.argv[2]);
const context = new Context();
let calls = 0;
try {
  problem.solve(context, (row) => {
    calls += 1;
    if (row.iteration === 1) throw new RangeError('raised at iteration 1');
    return true;
  });
} catch (error) {
  if (!(error instanceof RangeError)) throw error;
  console.log(`${error.message}: calls ${calls}`);
}
context.close();
problem.close();

try {
  Problem.readBal(process.argv[3]);
} catch (error) {
  if (!(error instanceof ClbaError)) throw error;
  console.log(`status ${error.status}: ${error.message}`);
}
