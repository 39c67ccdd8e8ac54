// Stacks on which the threads of a block run in turn, on one thread of the system.
#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <cstdlib>
#include <memory>
#include <vector>

#if !defined(__x86_64__)
#include <ucontext.h>
#endif
#if defined(EMULATED_IS_SANITIZED)
#include <sanitizer/asan_interface.h>
#include <sanitizer/common_interface_defs.h>
#endif

static constexpr size_t STACK_BYTES = 1 << 19, GUARD_BYTES = 1 << 16;

// Memory for a stack, below which an access faults.
class Stack {
public:
    Stack()
    {
        memory_ = (char*)mmap(nullptr, GUARD_BYTES + STACK_BYTES, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (memory_ == MAP_FAILED || mprotect(memory_, GUARD_BYTES, PROT_NONE) != 0)
            abort();
    }
    ~Stack() { munmap(memory_, GUARD_BYTES + STACK_BYTES); }
    Stack(const Stack&) = delete;
    Stack& operator=(const Stack&) = delete;
    char* begin() const { return memory_ + GUARD_BYTES; }

private:
    char* memory_;
};

#if defined(__x86_64__)
// Save the registers that a function has to preserve and the place to go on at, and go on at another such place. The
// functions of the system would do so with two calls of the kernel, a hundred times as slow.
extern "C" void switch_stacks(void** from, void* to) __asm__("emulated_switch_stacks");
__asm__(R"(
    .text
    .p2align 4
    .type emulated_switch_stacks, @function
emulated_switch_stacks:
    pushq %rbp
    pushq %rbx
    pushq %r12
    pushq %r13
    pushq %r14
    pushq %r15
    movq %rsp, (%rdi)
    movq %rsi, %rsp
    popq %r15
    popq %r14
    popq %r13
    popq %r12
    popq %rbx
    popq %rbp
    ret
    .size emulated_switch_stacks, .-emulated_switch_stacks
)");
#endif

// A function that runs on a stack of its own until it ends or yields to the one that resumed it.
class Fiber {
public:
    using Function = void (*)(void*);

    // Begin the function; returns when it yields or ends.
    void start(Function function, void* argument)
    {
#if defined(EMULATED_IS_SANITIZED)
        if (is_running_)  // never resumed, and the marks of its frames are left
            __asan_unpoison_memory_region(stack_.begin(), STACK_BYTES);
#endif
        function_ = function;
        argument_ = argument;
        is_running_ = true;
#if defined(__x86_64__)
        // as if it had been left by switch_stacks: six registers, and the address at which to go on; aligned as by a call
        void** top = (void**)(stack_.begin() + STACK_BYTES) - 2;
        *--top = nullptr;
        *--top = (void*)&Fiber::enter;
        for (int k = 0; k < 6; ++k)
            *--top = nullptr;
        own_ = top;
#else
        getcontext(&own_);
        own_.uc_stack.ss_sp = stack_.begin();
        own_.uc_stack.ss_size = STACK_BYTES;
        own_.uc_link = nullptr;
        makecontext(&own_, &Fiber::enter, 0);
#endif
        resume();
    }

    // Go on with the function.
    void resume()
    {
        current_ = this;
#if defined(EMULATED_IS_SANITIZED)
        void* fake = nullptr;
        __sanitizer_start_switch_fiber(&fake, stack_.begin(), STACK_BYTES);
#endif
#if defined(__x86_64__)
        switch_stacks(&caller_, own_);
#else
        swapcontext(&caller_, &own_);
#endif
#if defined(EMULATED_IS_SANITIZED)
        __sanitizer_finish_switch_fiber(fake, nullptr, nullptr);
#endif
    }

    // Called by the function: return to the one that has resumed it.
    void yield()
    {
#if defined(EMULATED_IS_SANITIZED)
        void* fake = nullptr;
        __sanitizer_start_switch_fiber(is_running_ ? &fake : nullptr, caller_begin_, caller_size_);
#endif
#if defined(__x86_64__)
        switch_stacks(&own_, caller_);
#else
        swapcontext(&own_, &caller_);
#endif
#if defined(EMULATED_IS_SANITIZED)
        __sanitizer_finish_switch_fiber(fake, &caller_begin_, &caller_size_);
#endif
    }

    bool is_running() const { return is_running_; }
    const char* stack() const { return stack_.begin(); }

private:
    static void enter()
    {
        Fiber* self = current_;
#if defined(EMULATED_IS_SANITIZED)
        __sanitizer_finish_switch_fiber(nullptr, &self->caller_begin_, &self->caller_size_);
#endif
        self->function_(self->argument_);
        self->is_running_ = false;
        self->yield();
        abort();  // an ended function is not resumed
    }

    static inline thread_local Fiber* current_ = nullptr;
    Stack stack_;
    Function function_ = nullptr;
    void* argument_ = nullptr;
    bool is_running_ = false;
#if defined(__x86_64__)
    void *own_ = nullptr, *caller_ = nullptr;
#else
    ucontext_t own_, caller_;
#endif
#if defined(EMULATED_IS_SANITIZED)
    const void* caller_begin_ = nullptr;
    size_t caller_size_ = 0;
#endif
};
