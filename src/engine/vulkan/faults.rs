//! Fault injection for tests: Vulkan calls that fail, and host allocations that fail.
//!
//! A hooked `vkGetInstanceProcAddr` replaces functions that return a `VkResult` by hooks of the same type, as a layer
//! does. It lies between the loader and this crate, including the allocator. The hooks also pass allocation callbacks
//! that count host memory. Faults are set per thread, so that concurrent tests do not see them.

use std::alloc::{self, Layout};
use std::any::TypeId;
use std::cell::{Cell, RefCell};
use std::ffi::{CStr, c_char, c_void};
use std::mem::{size_of, transmute, transmute_copy};
use std::ptr;
use std::sync::atomic::{AtomicIsize, AtomicPtr, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use ash::vk::{self, Result as Code};

/// A call to fail.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fault {
    /// The index among the calls that can fail.
    pub(crate) call: usize,
    /// The index of the result in [`Call::results`].
    pub(crate) result: usize,
    /// Whether all later calls that can return this result also fail.
    pub(crate) is_permanent: bool,
}

/// A call that can fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Call {
    pub(crate) name: &'static str,
    /// The errors that it can return. The last is `VK_ERROR_UNKNOWN`, which every call can return.
    pub(crate) results: &'static [Code],
}

/// The faults that are injected on a thread, and its log.
#[derive(Default)]
struct State {
    fault: Option<Fault>,
    /// Whether every wait times out at once.
    hangs: bool,
    calls: Vec<Call>,
    failed: Vec<(Call, Code)>,
    messages: Vec<String>,
}

thread_local! {
    static STATE: RefCell<State> = RefCell::default();
    /// The number of host allocations until one fails.
    static ALLOCATIONS_LEFT: Cell<Option<usize>> = const { Cell::new(None) };
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
    /// Whether new instances of this thread are hooked.
    static IS_HOOKED: Cell<bool> = const { Cell::new(false) };
    /// Counts what the calls of this thread allocate.
    static COUNTER: Cell<Counter> = Cell::new(Counter::new());
}

/// The log of a thread since [`begin`].
#[derive(Debug)]
pub(crate) struct Log {
    pub(crate) calls: Vec<Call>,
    /// The calls that failed, with their results.
    pub(crate) failed: Vec<(Call, Code)>,
    pub(crate) allocations: usize,
    /// Bytes of host memory that calls have allocated since [`begin`], and nobody has freed.
    pub(crate) leaked: isize,
    pub(crate) messages: Vec<String>,
}

/// Serializes the tests with hooked instances, since these share the functions behind the hooks.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Hooks the new instances of this thread, and fails a call, or the n-th host allocation.
pub(crate) fn begin(fault: Option<Fault>, allocation: Option<usize>) {
    IS_HOOKED.set(true);
    ALLOCATIONS_LEFT.set(allocation);
    ALLOCATIONS.set(0);
    COUNTER.set(Counter::new());
    STATE.replace(State { fault, ..State::default() });
}

/// Makes every wait of this thread time out at once, as on a hung device.
pub(crate) fn hang() {
    STATE.with_borrow_mut(|state| state.hangs = true);
}

/// Ends the hooking, and returns the log.
pub(crate) fn end() -> Log {
    IS_HOOKED.set(false);
    ALLOCATIONS_LEFT.set(None);
    let State { calls, failed, messages, .. } = STATE.take();
    Log { calls, failed, allocations: ALLOCATIONS.get(), leaked: COUNTER.get().bytes.load(Ordering::Relaxed), messages }
}

/// Logs a validation message.
pub(super) fn log_message(message: &str) {
    // The state may be destroyed already when the callback runs at the end of the thread.
    let _ = STATE.try_with(|state| state.borrow_mut().messages.push(message.to_string()));
}

/// Returns the entry, hooked between [`begin`] and [`end`].
pub(super) fn hook_entry(entry: ash::Entry) -> ash::Entry {
    if !IS_HOOKED.get() {
        return entry;
    }
    // The library stays loaded, since statics keep its functions.
    let entry = ENTRY.get_or_init(|| entry);
    store(&GET_INSTANCE_PROC_ADDR, entry.static_fn().get_instance_proc_addr as *mut c_void);
    // SAFETY: the hook returns the loader's functions or hooks of the same types.
    unsafe { ash::Entry::from_static_fn(ash::StaticFn { get_instance_proc_addr }) }
}

static ENTRY: OnceLock<ash::Entry> = OnceLock::new();
static GET_INSTANCE_PROC_ADDR: AtomicPtr<c_void> = AtomicPtr::new(ptr::null_mut());
static GET_DEVICE_PROC_ADDR: AtomicPtr<c_void> = AtomicPtr::new(ptr::null_mut());

fn store(target: &AtomicPtr<c_void>, function: *mut c_void) {
    target.store(function, Ordering::Release);
}

unsafe extern "system" fn get_instance_proc_addr(
    instance: vk::Instance,
    name: *const c_char,
) -> vk::PFN_vkVoidFunction {
    // SAFETY: `hook_entry` has stored the loader's function; the arguments are the caller's.
    let function = unsafe {
        let real: vk::PFN_vkGetInstanceProcAddr = transmute(GET_INSTANCE_PROC_ADDR.load(Ordering::Acquire));
        real(instance, name)
    };
    // SAFETY: the caller passes a null-terminated name.
    hook(unsafe { CStr::from_ptr(name) }, function)
}

unsafe extern "system" fn get_device_proc_addr(device: vk::Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: `hook` has stored the loader's function; the arguments are the caller's.
    let function = unsafe {
        let real: vk::PFN_vkGetDeviceProcAddr = transmute(GET_DEVICE_PROC_ADDR.load(Ordering::Acquire));
        real(device, name)
    };
    // SAFETY: the caller passes a null-terminated name.
    hook(unsafe { CStr::from_ptr(name) }, function)
}

/// Returns the hook of a function, or the function itself if there is none.
fn hook(name: &CStr, function: vk::PFN_vkVoidFunction) -> vk::PFN_vkVoidFunction {
    let pointer = function? as *mut c_void;
    if name == c"vkGetDeviceProcAddr" {
        store(&GET_DEVICE_PROC_ADDR, pointer);
        // SAFETY: function pointers have one size, and the caller converts this one back to the type of its name.
        return Some(unsafe {
            transmute::<vk::PFN_vkGetDeviceProcAddr, unsafe extern "system" fn()>(get_device_proc_addr)
        });
    }
    let Some((index, hook)) = CALLS.iter().enumerate().find(|(_, call)| call.0.name.as_bytes() == name.to_bytes())
    else {
        return function;
    };
    store(&FUNCTIONS[index], pointer);
    Some(hook.1())
}

/// The functions behind the hooks. With one loader and one set of layers they are the same for all instances.
static FUNCTIONS: [AtomicPtr<c_void>; COUNT] = [const { AtomicPtr::new(ptr::null_mut()) }; COUNT];

/// Logs a call, and returns the result of its fault, if it has one.
fn injected_result(index: usize) -> Option<Code> {
    let call = CALLS[index].0;
    STATE.with_borrow_mut(|state| {
        if call.results.is_empty() || !IS_HOOKED.get() {
            return None;
        }
        state.calls.push(call);
        if state.hangs && call.name == "vkWaitSemaphores" {
            return Some(Code::TIMEOUT);
        }
        let (fault, index) = (state.fault?, state.calls.len() - 1);
        let result = match state.failed.first() {
            None if index == fault.call => call.results[fault.result],
            Some((_, result)) if fault.is_permanent && call.results.contains(result) => *result,
            _ => return None,
        };
        state.failed.push((call, result));
        Some(result)
    })
}

/// Replaces a pointer to allocation callbacks, which is null, by the counting callbacks. Returns other arguments
/// unchanged.
fn with_callbacks<A: Copy + 'static>(argument: A) -> A {
    if TypeId::of::<A>() != TypeId::of::<*const vk::AllocationCallbacks<'static>>() {
        return argument;
    }
    let callbacks: *const vk::AllocationCallbacks<'static> = COUNTER.get().callbacks;
    // SAFETY: the type ids are equal.
    unsafe { transmute_copy(&callbacks) }
}

/// Modules with hooks for functions of a number of arguments, of any type.
macro_rules! hooks {
    ($($module:ident: $($argument:ident)*;)*) => {$(
        mod $module {
            use super::*;

            #[expect(non_snake_case, reason = "arguments are named after their types")]
            unsafe extern "system" fn hook<const INDEX: usize, $($argument: Copy + 'static,)* R: ReturnValue>(
                $($argument: $argument),*
            ) -> R {
                let injected = injected_result(INDEX);
                // A lost device has no pending work, so that the wait for the real device precedes the result.
                let waits = CALLS[INDEX].0.name == "vkWaitSemaphores" && injected == Some(Code::ERROR_DEVICE_LOST);
                if let Some(code) = injected && !waits {
                    return R::from_code(code);
                }
                // SAFETY: `super::hook` has stored the function of this name, which has this type. The arguments are
                // the caller's, except for callbacks, which are valid for every call.
                let returned = unsafe {
                    let function: unsafe extern "system" fn($($argument),*) -> R = transmute(FUNCTIONS[INDEX].load(Ordering::Acquire));
                    function($(with_callbacks($argument)),*)
                };
                injected.map_or(returned, R::from_code)
            }

            /// Returns the hook for a function of this type.
            pub(super) fn hook_for<const INDEX: usize, $($argument: Copy + 'static,)* R: ReturnValue>(
                _: CallIndex<INDEX>,
                _: Option<unsafe extern "system" fn($($argument),*) -> R>,
            ) -> unsafe extern "system" fn() {
                // SAFETY: function pointers have one size, and the caller converts this one back to the type of its
                // name.
                unsafe {
                    transmute::<unsafe extern "system" fn($($argument),*) -> R, unsafe extern "system" fn()>(
                        hook::<INDEX, $($argument,)* R>,
                    )
                }
            }
        }
    )*};
}

hooks! {
    one: A;
    two: A B;
    three: A B C;
    four: A B C D;
    six: A B C D E F;
    seven: A B C D E F G;
    eight: A B C D E F G H;
}

/// The return type of a function.
trait ReturnValue: Copy + 'static {
    fn from_code(code: Code) -> Self;
}

impl ReturnValue for Code {
    fn from_code(code: Code) -> Self {
        code
    }
}

impl ReturnValue for () {
    fn from_code(_: Code) {}
}

const HOST: Code = Code::ERROR_OUT_OF_HOST_MEMORY;
const DEVICE: Code = Code::ERROR_OUT_OF_DEVICE_MEMORY;
const LOST: Code = Code::ERROR_DEVICE_LOST;
const UNKNOWN: Code = Code::ERROR_UNKNOWN;

type Hook = fn() -> unsafe extern "system" fn();

/// The index of a call as a type.
#[derive(Clone, Copy)]
struct CallIndex<const INDEX: usize>;

/// The table of hooks: the number of arguments, the function type, which gives the name, and the errors that the Vulkan
/// specification lists. A call without errors is hooked for its allocation callbacks only.
macro_rules! calls {
    ($($count:ident $pfn:ident $([$($result:expr),+])?;)*) => {
        #[expect(non_camel_case_types, reason = "named after the functions of Vulkan")]
        enum Index { $($pfn),* }

        const COUNT: usize = [$(Index::$pfn as usize),*].len();

        static CALLS: [(Call, Hook); COUNT] = [$((
            Call { name: stringify!($pfn).split_at("PFN_".len()).1, results: &[$($($result,)+ UNKNOWN)?] },
            || $count::hook_for(CallIndex::<{ Index::$pfn as usize }>, None::<vk::$pfn>),
        )),*];
    };
}

calls! {
    three PFN_vkEnumerateInstanceExtensionProperties [HOST, DEVICE];
    three PFN_vkCreateInstance [HOST, DEVICE, Code::ERROR_INITIALIZATION_FAILED, Code::ERROR_INCOMPATIBLE_DRIVER];
    two PFN_vkDestroyInstance;
    four PFN_vkCreateDebugUtilsMessengerEXT [HOST];
    three PFN_vkDestroyDebugUtilsMessengerEXT;
    three PFN_vkEnumeratePhysicalDevices [HOST, DEVICE, Code::ERROR_INITIALIZATION_FAILED];
    four PFN_vkEnumerateDeviceExtensionProperties [HOST, DEVICE];
    seven PFN_vkGetPhysicalDeviceImageFormatProperties [HOST, DEVICE, Code::ERROR_FORMAT_NOT_SUPPORTED];
    four PFN_vkCreateDevice [HOST, DEVICE, LOST, Code::ERROR_INITIALIZATION_FAILED, Code::ERROR_TOO_MANY_OBJECTS];
    two PFN_vkDestroyDevice;
    two PFN_vkSetDebugUtilsObjectNameEXT [HOST, DEVICE];
    four PFN_vkCreatePipelineCache [HOST, DEVICE];
    three PFN_vkDestroyPipelineCache;
    four PFN_vkGetPipelineCacheData [HOST, DEVICE, Code::INCOMPLETE];
    four PFN_vkCreateDescriptorSetLayout [HOST, DEVICE];
    three PFN_vkDestroyDescriptorSetLayout;
    four PFN_vkCreatePipelineLayout [HOST, DEVICE];
    three PFN_vkDestroyPipelineLayout;
    four PFN_vkCreateShaderModule [HOST, DEVICE];
    three PFN_vkDestroyShaderModule;
    six PFN_vkCreateComputePipelines [HOST, DEVICE, Code::ERROR_INVALID_SHADER_NV];
    three PFN_vkDestroyPipeline;
    four PFN_vkCreateBuffer [HOST, DEVICE];
    three PFN_vkDestroyBuffer;
    four PFN_vkBindBufferMemory [HOST, DEVICE];
    four PFN_vkCreateImage [HOST, DEVICE];
    three PFN_vkDestroyImage;
    four PFN_vkBindImageMemory [HOST, DEVICE];
    four PFN_vkCreateImageView [HOST, DEVICE];
    three PFN_vkDestroyImageView;
    four PFN_vkAllocateMemory [HOST, DEVICE, Code::ERROR_TOO_MANY_OBJECTS];
    three PFN_vkFreeMemory;
    six PFN_vkMapMemory [HOST, DEVICE, Code::ERROR_MEMORY_MAP_FAILED];
    four PFN_vkCreateCommandPool [HOST, DEVICE];
    three PFN_vkDestroyCommandPool;
    three PFN_vkAllocateCommandBuffers [HOST, DEVICE];
    two PFN_vkBeginCommandBuffer [HOST, DEVICE];
    one PFN_vkEndCommandBuffer [HOST, DEVICE];
    four PFN_vkCreateDescriptorPool [HOST, DEVICE, Code::ERROR_FRAGMENTATION];
    three PFN_vkDestroyDescriptorPool;
    three PFN_vkAllocateDescriptorSets [HOST, DEVICE, Code::ERROR_FRAGMENTED_POOL, Code::ERROR_OUT_OF_POOL_MEMORY];
    four PFN_vkCreateQueryPool [HOST, DEVICE];
    three PFN_vkDestroyQueryPool;
    eight PFN_vkGetQueryPoolResults [HOST, DEVICE, LOST, Code::NOT_READY];
    four PFN_vkCreateSemaphore [HOST, DEVICE];
    three PFN_vkDestroySemaphore;
    four PFN_vkQueueSubmit2 [HOST, DEVICE, LOST];
    three PFN_vkWaitSemaphores [HOST, DEVICE, LOST, Code::TIMEOUT];
    one PFN_vkDeviceWaitIdle [HOST, DEVICE, LOST];
}

/// Counts bytes of host memory that are allocated and not freed. The user data of its callbacks are the number of bytes.
/// A driver keeps the callbacks of an object, and each allocation its counter. So an abandoned device, whose threads go
/// on, does not change the counters of later tests.
#[derive(Clone, Copy)]
struct Counter {
    bytes: &'static AtomicIsize,
    callbacks: &'static vk::AllocationCallbacks<'static>,
}

impl Counter {
    fn new() -> Self {
        let bytes: &AtomicIsize = Box::leak(Box::default());
        let callbacks = Box::leak(Box::new(vk::AllocationCallbacks {
            p_user_data: ptr::from_ref(bytes).cast_mut().cast(),
            pfn_allocation: Some(allocate),
            pfn_reallocation: Some(reallocate),
            pfn_free: Some(free),
            ..Default::default()
        }));
        Self { bytes, callbacks }
    }
}

/// The space before each allocation for its size, its alignment and its counter.
const HEADER_BYTES: usize = 3 * size_of::<usize>();

unsafe extern "system" fn allocate(
    user: *mut c_void,
    size: usize,
    alignment: usize,
    _: vk::SystemAllocationScope,
) -> *mut c_void {
    ALLOCATIONS.set(ALLOCATIONS.get() + 1);
    let left = ALLOCATIONS_LEFT.get();
    ALLOCATIONS_LEFT.set(left.and_then(|left| left.checked_sub(1)));
    let offset = HEADER_BYTES.next_multiple_of(alignment.max(1));
    let layout = Layout::from_size_align(offset + size, alignment.max(align_of::<usize>()));
    let (Ok(layout), false) = (layout, left == Some(0)) else { return ptr::null_mut() };
    // SAFETY: the layout is not empty. The header lies within the allocation, before the returned pointer, and is
    // aligned, since the offset is a multiple of both alignments.
    unsafe {
        let start = alloc::alloc(layout);
        if start.is_null() {
            return ptr::null_mut();
        }
        let returned = start.add(offset);
        returned.cast::<usize>().sub(1).write(layout.size());
        returned.cast::<usize>().sub(2).write(layout.align());
        returned.cast::<*mut c_void>().sub(3).write(user);
        count(user, layout.size() as isize);
        returned.cast()
    }
}

/// Adds to the bytes of a counter.
///
/// # Safety
/// `user` is the user data of a [`Counter`]'s callbacks.
unsafe fn count(user: *mut c_void, bytes: isize) {
    // SAFETY: counters live until the program ends.
    unsafe { &*user.cast::<AtomicIsize>() }.fetch_add(bytes, Ordering::Relaxed);
}

/// Returns the start and the layout of an allocation.
///
/// # Safety
/// `pointer` came from [`allocate`].
unsafe fn layout_of(pointer: *mut c_void) -> (*mut u8, Layout) {
    // SAFETY: `allocate` has written the size and the alignment of a valid layout.
    unsafe {
        let (size, align) = (pointer.cast::<usize>().sub(1).read(), pointer.cast::<usize>().sub(2).read());
        // An alignment below that of a word gives the same offset.
        (pointer.cast::<u8>().sub(HEADER_BYTES.next_multiple_of(align)), Layout::from_size_align_unchecked(size, align))
    }
}

unsafe extern "system" fn free(_: *mut c_void, pointer: *mut c_void) {
    if pointer.is_null() {
        return;
    }
    // SAFETY: Vulkan frees each pointer from `allocate` once.
    unsafe {
        let (start, layout) = layout_of(pointer);
        count(pointer.cast::<*mut c_void>().sub(3).read(), -(layout.size() as isize));
        alloc::dealloc(start, layout);
    }
}

unsafe extern "system" fn reallocate(
    user: *mut c_void,
    original: *mut c_void,
    size: usize,
    alignment: usize,
    scope: vk::SystemAllocationScope,
) -> *mut c_void {
    if size == 0 {
        // SAFETY: the arguments are the caller's.
        unsafe { free(user, original) };
        return ptr::null_mut();
    }
    // SAFETY: the arguments are the caller's; the copy is no longer than either allocation.
    unsafe {
        let returned = allocate(user, size, alignment, scope);
        if !returned.is_null() && !original.is_null() {
            let (start, layout) = layout_of(original);
            let old_size = layout.size() - (original as usize - start as usize);
            ptr::copy_nonoverlapping(original.cast::<u8>(), returned.cast::<u8>(), old_size.min(size));
            free(user, original);
        }
        returned
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_earlier_engine_allocates_and_frees_late_is_not_counted() {
        begin(None, None);
        let earlier = COUNTER.get().callbacks.p_user_data;
        // SAFETY: `earlier` is a counter's. Each allocation is freed once.
        unsafe {
            let allocated = || allocate(earlier, 100, 8, vk::SystemAllocationScope::OBJECT);
            let first = allocated();
            assert!(end().leaked >= 100);
            begin(None, None);
            free(earlier, first);
            let second = allocated();
            assert_eq!(end().leaked, 0);
            free(earlier, second);
        }
    }
}
