// SPDX-License-Identifier: Apache-2.0

package clba

// #include <clba/clba.h>
import "C"

import (
	"runtime/cgo"
	"unsafe"
)

// Iteration holds the fields of clba_iteration that the program prints.
type Iteration struct {
	Iteration int
	Cost      float64
}

// What the handle in user_data leads to during a solve.
type call struct {
	onIteration func(*Iteration) bool
	panicked    any
}

// A panic must not unwind into C: it is kept, and goes on when the solve has returned.
//
//export clba_go_on_iteration
func clba_go_on_iteration(row *C.clba_iteration, handle unsafe.Pointer) (stop C.int32_t) {
	call := cgo.Handle(uintptr(handle)).Value().(*call)
	defer func() {
		if call.panicked = recover(); call.panicked != nil {
			stop = 1
		}
	}()
	if call.onIteration(&Iteration{int(row.iteration), float64(row.cost)}) {
		return 0
	}
	return 1
}
