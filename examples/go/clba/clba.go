// SPDX-License-Identifier: Apache-2.0

// Package clba is clba.h for Go, as far as the program beside it needs it. cgo reads the structs from
// the header, so that no layout is declared here.
package clba

/*
#cgo pkg-config: clba
#include <clba/clba.h>
#include <stdlib.h>

int32_t clba_go_on_iteration(clba_iteration* row, void* handle);

// The handle is a number, which Go may not convert to a pointer itself.
static void set_callback(clba_solver_options* options, uintptr_t handle) {
    options->on_iteration = (clba_iteration_fn)clba_go_on_iteration;
    options->user_data = (void*)handle;
}
*/
import "C"

import (
	"fmt"
	"runtime"
	"runtime/cgo"
	"unsafe"
)

// Error is a failed call.
type Error struct {
	Status  int
	Message string
}

func (e *Error) Error() string { return e.Message }

// The message belongs to the operating system's thread that made the call, so the goroutine must stay
// on it until the message is read.
func check(call func() C.clba_status) error {
	runtime.LockOSThread()
	defer runtime.UnlockOSThread()
	status := call()
	if status == C.CLBA_OK {
		return nil
	}
	return &Error{int(status), C.GoString(C.clba_last_error())}
}

// CheckVersion compares the library loaded with the header that was compiled: before 1.0 a minor
// version may break the interface.
func CheckVersion() error {
	if loaded := C.clba_version(); loaded/100 != C.CLBA_VERSION/100 {
		return fmt.Errorf("clba has version %d, but the program was built for %d", loaded,
			C.CLBA_VERSION)
	}
	return nil
}

// Context is a device and the kernels built for it.
type Context struct{ handle *C.clba_context }

// NewContext takes the best device.
func NewContext() (*Context, error) {
	context := &Context{}
	err := check(func() C.clba_status { return C.clba_context_create(nil, &context.handle) })
	return context, err
}

// Close releases the context; the garbage collector does not.
func (c *Context) Close() {
	C.clba_context_release(c.handle)
	c.handle = nil
}

// Problem is used by one goroutine at a time.
type Problem struct{ handle *C.clba_problem }

// ReadBAL reads a file of Bundle Adjustment in the Large.
func ReadBAL(path string) (*Problem, error) {
	cPath := C.CString(path)
	defer C.free(unsafe.Pointer(cPath))
	problem := &Problem{}
	err := check(func() C.clba_status { return C.clba_problem_read_bal(cPath, &problem.handle) })
	return problem, err
}

// Close releases the problem.
func (p *Problem) Close() {
	C.clba_problem_release(p.handle)
	p.handle = nil
}

// Solve calls onIteration after each iteration, until it returns false. If it panics, the solve stops
// and Solve panics with the same value.
func (p *Problem) Solve(context *Context, onIteration func(*Iteration) bool) (*Result, error) {
	var options C.clba_solver_options
	err := check(func() C.clba_status {
		return C.clba_solver_options_init(&options, C.sizeof_clba_solver_options)
	})
	if err != nil {
		return nil, err
	}
	call := &call{onIteration: onIteration}
	handle := cgo.NewHandle(call)
	defer handle.Delete()
	C.set_callback(&options, C.uintptr_t(handle))
	result := &Result{}
	err = check(func() C.clba_status {
		return C.clba_problem_solve(p.handle, context.handle, &options, &result.handle)
	})
	if call.panicked != nil {
		result.Close()
		panic(call.panicked)
	}
	return result, err
}

// Result is what a solve did.
type Result struct{ handle *C.clba_result }

// Close releases the result.
func (r *Result) Close() {
	C.clba_result_release(r.handle)
	r.handle = nil
}

// Summary holds the fields of clba_summary that the program prints.
type Summary struct {
	StoppedByUser bool
	FinalCost     float64
}

// Summary of the solve.
func (r *Result) Summary() (Summary, error) {
	var summary C.clba_summary
	summary.struct_size = C.sizeof_clba_summary
	err := check(func() C.clba_status { return C.clba_result_get_summary(r.handle, &summary) })
	return Summary{summary.termination == C.CLBA_USER_STOP, float64(summary.final_cost)}, err
}

// Report is the whole summary for people.
func (r *Result) Report() string { return C.GoString(C.clba_result_report(r.handle)) }
